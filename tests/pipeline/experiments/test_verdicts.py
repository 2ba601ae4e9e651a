"""Whether networks plan safely and cheaply, from planted numbers whose verdict is known."""

import numpy as np
import pandas as pd
import pytest
from planted import flown, shares, trained

from pipeline.experiments.averages import prepared
from pipeline.experiments.experiment1 import findings
from pipeline.experiments.experiment2 import size_findings


@pytest.fixture
def ask(rows):
    """The first answer on networks with given safe trials of 400, and fuel over the bound."""

    def asked(training, **networks):
        table = [
            *flown(rows, "decoupled optimum", "", shares(200), 1.0, reading="plan"),
            *(
                row
                for name, (safe, fuel, seeds) in networks.items()
                for seed in range(seeds)
                for row in flown(rows, name, "tuned", shares(safe), fuel, seed=seed)
            ),
        ]
        return next(findings(prepared(pd.DataFrame(table)), training, 10))

    return asked


def test_the_network_that_speaks_for_the_others_is_picked_by_validation_not_by_the_trials(ask):
    training = trained(("ff1", "tuned", 0.60, 1.0), ("lstm1", "tuned", 0.50, 0.5))
    answer = ask(training, ff1=(190, 1.3, 2), lstm1=(240, 1.2, 2))
    assert answer.numbers.startswith("FF1 tuned, best on validation: safe in 47.5 % [")
    assert "all 2: safe in 47.5 % to 60 %" in answer.numbers
    # Wilson's interval of 60 % in 500 begins at 55.6 %: 58 % may be as safe, and is cheaper.
    tied = trained(("ff1", "tuned", 0.60, 1.0), ("lstm1", "tuned", 0.58, 0.5))
    assert "LSTM1 tuned, best" in ask(tied, ff1=(190, 1.3, 2), lstm1=(240, 1.2, 2)).numbers


def test_without_validation_all_networks_are_named_and_none_is_picked(ask):
    answer = ask(trained(), ff1=(190, 1.3, 2), lstm1=(240, 1.2, 2))
    assert answer.numbers == "all 2: safe in 47.5 % to 60 %"


def test_shares_have_wilsons_interval_and_fuel_a_students(ask):
    answer = ask(trained(("ff1", "tuned", 0.5, 1.0)), ff1=(200, 1.3, 1))
    # Wilson of 200 in 400 is symmetric about a half: 0.5 ± 1.96 / 2 / √(400 + 1.96²)
    half = 100 * 1.959964 / 2 / (400 + 1.959964**2) ** 0.5
    assert f"safe in 50 % [{50 - half:.1f}, {50 + half:.1f}]" in answer.numbers
    # 1.29 and 1.31 in turn: 1.3 ± 1.966 · 0.01 / √400
    assert "at 1.300 [1.299, 1.301] of the bound" in answer.numbers


def test_the_best_free_baseline_stands_beside_and_is_compared_trial_by_trial(ask):
    answer = ask(trained(("ff1", "tuned", 0.5, 1.0)), ff1=(220, 1.3, 1))
    assert answer.baseline.startswith("Decoupled optimum: safe in 50 % [45.1, 54.9] at 1.000 [")
    # The same order: 20 of 400 are safe with the network alone, none with the baseline alone.
    held = "on the same trials: +5.0 % safe [+2.8, +7.2]"
    assert held in answer.baseline, "Newcombe's interval; test_intervals has its truth"


def test_one_trial_has_fuel_without_an_interval_and_decides_nothing(rows):
    one = pd.DataFrame(flown(rows, "ff1", "tuned", [True], 1.3))
    (answer,) = findings(prepared(one), trained(("ff1", "tuned", 0.5, 1.0)), 10)
    assert answer.verdict.startswith("Open")
    assert "at 1.310 of the bound" in answer.numbers


@pytest.mark.parametrize(
    ("safe", "fuel", "seeds", "verdict"),
    [
        (200, 1.3, 2, "No: neither safe nor cheap"),
        (200, 1.05, 2, "No: not safe"),
        (400, 1.05, 2, "Yes"),
        (400, 1.05, 1, "Yes"),
        (400, 1.3, 2, "No: safe, not cheap"),
        (384, 1.05, 2, "Open: too few trials"),  # 96 % [93.6, 97.5] has 95 % in it
    ],
)
def test_a_verdict_is_what_the_intervals_leave_no_doubt_about(ask, safe, fuel, seeds, verdict):
    answer = ask(trained(("ff1", "tuned", 0.5, 1.0)), ff1=(safe, fuel, seeds))
    assert answer.verdict == verdict


def test_what_one_training_does_and_others_do_not_is_said_of_it_alone(ask):
    training = trained(("ff1", "tuned", 0.9, 1.0), ("lstm1", "tuned", 0.5, 1.0))
    assert ask(training, ff1=(400, 1.0, 1), lstm1=(200, 1.0, 1)).verdict == "Yes, for one training"
    assert ask(training, ff1=(400, 1.0, 2), lstm1=(200, 1.0, 1)).verdict == "Yes"


def test_the_largest_swarm_has_a_row_of_its_own(rows):
    table = [
        *flown(rows, "ff1", "tuned", shares(400), 1.0),
        *flown(rows, "ff1", "tuned", shares(100), 1.2, n=30),
    ]
    planned = prepared(pd.DataFrame(table))
    (home,) = findings(planned, trained(), 10)
    training = trained(("ff1", "tuned", 1.0, 1.0))
    (largest,) = size_findings(planned, training, 10)
    assert home.question.endswith("(n = 10)?")
    assert "trained at n = 10 work at other sizes (n = 30)" in largest.question
    assert largest.numbers.startswith("FF1 tuned: safe in 25 % [")
    (smaller,) = size_findings(planned, training.assign(n=5), 10)
    assert "networks trained at n = 5 work at other sizes (n = 30)" in smaller.question
    (unknown,) = size_findings(planned, trained(), 10)
    assert "networks work at other sizes (n = 30)" in unknown.question
    assert list(size_findings(planned, training.assign(n=30), 10)) == []


def test_a_network_is_asked_about_by_the_sizes_that_it_was_trained_at_itself(rows):
    named = ("ff1", "refiner")
    table = [row for name in named for row in flown(rows, name, "tuned", shares(400), 1.0, n=30)]
    planned = prepared(pd.DataFrame(table))
    training = trained(*((name, "tuned", 1.0, 1.0) for name in named)).assign(n=[10, 4])
    asked = [found.question for found in size_findings(planned, training, 10)]
    assert asked == [
        "Does one of the paper's networks trained at n = 10 work at other sizes (n = 30)?",
        "Does the refiner trained at n = 4 work at other sizes (n = 30)?",
    ]
    (other,) = size_findings(planned, training.assign(n=[10, 30]), 10)
    assert other.question == asked[0]


def test_the_papers_networks_answer_together_and_any_other_on_its_own(rows):
    table = [
        *flown(rows, "ff1", "tuned", shares(190), 1.3),
        *flown(rows, "lstm1/3", "tuned", shares(240), 1.3),  # one version of several
        *flown(rows, "refiner", "tuned", shares(400), 1.01),
        *flown(rows, "my net", "tuned", shares(200), 1.05),
    ]
    training = trained(("ff1", "tuned", 0.5, 1.0), ("refiner", "tuned", 1.0, 1.0))
    papers, refiner, mine = findings(prepared(pd.DataFrame(table)), training, 10)
    assert papers.question == "Do the paper's networks plan safely and cheaply (n = 10)?"
    assert papers.numbers.startswith("FF1 tuned, best on validation: safe in 47.5 % [")
    assert papers.numbers.endswith("all 2: safe in 47.5 % to 60 %")
    assert refiner.question == "Does the refiner plan safely and cheaply (n = 10)?"
    assert refiner.verdict == "Yes"
    assert refiner.numbers.startswith("Refiner tuned: safe in 100 % [")
    assert (mine.question[:11], mine.verdict) == ("Does my net", "No: not safe")


def test_nothing_but_a_number_is_missing_where_a_bound_is_none(rows):
    """A scenario without fuel in its bound says nothing about fuel over the bound."""
    table = pd.DataFrame(flown(rows, "ff1", "tuned", [True, True], 1.0))
    table["fuel_lower_bound"] = [0.0, 1.0]
    assert np.isnan(prepared(table)["fuel_ratio"].iloc[0])
    (answer,) = findings(prepared(table), trained(("ff1", "tuned", 1.0, 1.0)), 10)
    assert "at 0.990 of the bound" in answer.numbers
