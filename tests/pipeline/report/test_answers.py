import pandas as pd

from pipeline.report.answers.questions import answers
from pipeline.report.summary.trials import summarize


def test_the_first_question_is_answered_by_the_safest_network(trials):
    text = answers(summarize(trials), 10)
    assert "Yes, safe and cheap: at n = 10 the safest network, my net (tuned recipe)" in text
    assert "in 100 % of 2 trials and burns 1.060 times the lower bound" in text
    assert "the expert 100 % at 1.010" in text
    assert "minimum-energy transfer 50 % at 1.350" in text
    assert "paper's recipe, FF1, 50 % at 3.000" in text


def test_a_network_that_is_neither_safe_nor_cheap_is_called_so(trials):
    text = answers(summarize(trials[trials["planner"] != "my net"]), 10)
    assert "Neither safe nor cheap: at n = 10 the safest network, FF1 (paper recipe)" in text


def test_cheap_plans_that_collide_are_not_called_safe(rows):
    table = pd.DataFrame(
        rows("ff1", "tuned", "flown", 10, [1] * 4, [1.0] * 4, [True, *[False] * 3])
    )
    assert "Cheap, but not safe" in answers(summarize(table), 10)


def test_the_second_question_names_where_the_network_is_least_safe(rows):
    table = pd.DataFrame(
        [
            *rows("ff1", "tuned", "flown", 2, [0] * 4, [1.0] * 4, [True] * 4),
            *rows("ff1", "tuned", "flown", 10, [0] * 4, [1.0] * 4, [True] * 4),
            *rows("ff1", "tuned", "flown", 20, [0] * 4, [1.0] * 4, [True] + [False] * 3),
            *rows("ff1", "tuned", "flown", 30, [0] * 4, [1.2] * 4, [True] * 2 + [False] * 2),
        ]
    )
    text = answers(summarize(table), 10)
    assert "serve other n?** Not safely on its own: at n = 30" in text
    assert "safe in 50 % of the trials at 1.200 times the bound, against 100 % and 1.000" in text
    assert "over n = 2 to 30 its share of safe trials is lowest at n = 20 (25 %)" in text


def test_one_swarm_size_leaves_the_second_question_open(trials_at):
    text = answers(summarize(trials_at(6)), 6)
    assert "trained at n = 10 serve other n?** Only n = 6 was evaluated" in text


def families(rows, forward, recurrent):
    return pd.DataFrame(
        [
            *rows("ff1", "paper", "predicted", 30, forward, [1.0] * 2, [None] * 2),
            *rows("ff1", "paper", "flown", 30, [99, 99], [1.0] * 2, [False] * 2),
            *rows("lstm1", "paper", "predicted", 30, recurrent, [1.0] * 2, [None] * 2),
            *rows("lstm2", "paper", "predicted", 30, [5, 6], [1.0] * 2, [None] * 2),
        ]
    )


def test_the_papers_finding_on_the_families_is_judged_in_its_own_reading(rows):
    confirmed = answers(summarize(families(rows, [1, 2], [7, 8])), 30)
    assert "our numbers confirm that" in confirmed
    assert "at n = 30 over 2 trials, the paper recipe, as predicted, " in confirmed
    assert "FF1 1.50 against LSTM1 7.50, LSTM2 5.50" in confirmed
    contradicted = answers(summarize(families(rows, [20, 22], [7, 8])), 30)
    assert "our numbers contradict that" in contradicted
    mixed = answers(summarize(families(rows, [6, 6], [7, 8])), 30)
    assert "our numbers neither confirm nor contradict that" in mixed


def test_without_a_flown_network_the_questions_stay_open(trials):
    only = trials[trials["planner"].isin(["expert", "minimum energy"])]
    assert "stay open" in answers(summarize(only), 10)


def test_a_difference_within_the_spread_of_the_seeds_is_no_finding(rows):
    def seeded(*forward):
        return pd.DataFrame(
            [
                row
                for seed, collisions in enumerate(forward)
                for row in rows(
                    *("ff1", "paper", "predicted", 30, [collisions] * 2, [1.0] * 2, [None] * 2),
                    training_seed=seed,
                )
            ]
            + rows("ff1", "paper", "flown", 30, [0, 0], [1.0] * 2, [True] * 2)
            + rows("lstm1", "paper", "predicted", 30, [7, 7], [1.0] * 2, [None] * 2)
        )

    sure = answers(summarize(seeded(4, 5, 6)), 30)
    assert "our numbers confirm" in sure
    assert "FF1 5.00 ± 1.00 against LSTM1 7.00" in sure
    unsure = answers(summarize(seeded(2, 5, 8)), 30)  # the same average, three apart
    assert "our numbers neither confirm nor contradict" in unsure
