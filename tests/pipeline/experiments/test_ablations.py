"""Ablations: planted numbers of refiners, the rule and the own LP."""

import pandas as pd
import pytest
from planted import cells, row

from pipeline.errors import InputError
from pipeline.experiments.ablations import (
    difference,
    findings,
    parts_table,
    percent,
    rounds_figure,
    rounds_table,
    scored,
    summarize_ablations,
)
from pipeline.figures.style import styles
from pipeline.report import Results, build_report

TRIALS = 40
LOOK = styles(["refiner", "rule", "own LP"])


@pytest.fixture
def tried(rows):
    """A refiner's rows: fuel over bound, unsafe trials of 40, rounds taken of the own 8."""

    def made(planner, recipe, excess, unsafe=0, rounds=8, n=10, seed=0, family="rings"):
        fuel = [1 + excess] * TRIALS
        safe = [k >= unsafe for k in range(TRIALS)]
        close = [0 if kept else 2 for kept in safe]
        told = {"training_seed": seed, "family": family, "rounds": rounds, "own_rounds": 8}
        return rows(planner, recipe, "plan", n, close, fuel, safe, **told)

    return made


@pytest.fixture
def some(tried):
    """Third sides are worth 0.8 %, crowded swarms nothing, or less than that."""

    def made(n=10, rule=(0.02, 0), tuned=0.01, uncrowded=0.012, family="rings"):
        on = {"n": n, "family": family}
        return [
            *tried("rule", "", *rule, **on),
            *tried("rule, null space", "", 0.05, **on),
            *tried("own LP", "", 0.0, 20, rounds=0, **on),
            *tried("refiner", "no-third", 0.020, **on),
            *tried("refiner", "uncrowded", uncrowded, **on),
            *tried("refiner", "short", 0.012, **on),
            *tried("refiner", "tuned", tuned, **on),
            *tried("refiner", "tuned", 0.03, 4, rounds=2, **on),
            *tried("rule", "", 0.04, 10, rounds=2, **on),
        ]

    return made


def test_a_row_has_the_averages_of_its_trials_and_the_score_counts_an_unsafe_one_as_ten_percent(
    some,
):
    summary = summarize_ablations(pd.DataFrame(some()))
    early = row(summary, planner="refiner", recipe="tuned", rounds=2)
    assert early["unsafe_share"] == pytest.approx(0.1)
    assert early["collisions_mean"] == pytest.approx(0.2)
    assert early["excess_mean"] == pytest.approx(0.03)
    assert early["score_mean"] == pytest.approx(0.03 + 0.1 * 0.1)
    assert early["seconds_mean"] == 0.25
    own = row(summary, planner="own LP")
    assert (own["score_mean"], own["rounds"]) == (pytest.approx(0.05), 0)


def test_rows_stand_in_the_order_of_what_is_left_out(some):
    table = pd.DataFrame(some())
    _, body = cells(parts_table("n = 10", scored(table), summarize_ablations(table)))
    names = ["tuned", "short", "no-third", "uncrowded", "Rule alone", "Rule alone, null space"]
    assert [line[0] for line in body] == [*names, "Own LP"]
    assert [line[1] for line in body][-3:] == ["learning", "learning, and programs", "rounds"]
    assert body[2] == [
        *("no-third", "what other sides say", "0 % [0.0, 8.8]", "0", "2.00 %"),
        *("+0.800 % [+0.800, +0.800]", "0.250"),
    ]
    assert body[1][5] == "–"
    assert body[-1][2] == "50 % [35.2, 64.8]", "Wilson of 20 in 40"
    assert body[-1][5].startswith("+3.800 % "), "5 % for half of the trials, less 1.2 %"


def test_the_table_of_rounds_begins_with_the_own_lp_for_all(some):
    header, body = cells(rounds_table("n = 10", summarize_ablations(pd.DataFrame(some()))))
    assert header[:3] == ["Rounds", "tuned, unsafe", "tuned, fuel over bound"]
    assert header[-2:] == ["Rule alone, unsafe", "Rule alone, fuel over bound"]
    by_rounds = {line[0]: line[1:] for line in body}
    assert list(by_rounds) == ["0", "2", "8"]
    assert by_rounds["0"] == ["50 % [35.2, 64.8]", "0 %"] * 3
    assert by_rounds["2"][:2] == ["10 % [4.0, 23.1]", "3.00 %"]
    assert by_rounds["2"][2:4] == ["–", "–"], "short was not tried after 2 rounds"
    assert by_rounds["2"][4:] == ["25 % [14.2, 40.2]", "4.00 %"]


def test_the_figure_has_unsafe_trials_from_no_round_on_and_fuel_from_the_first(some):
    summary = summarize_ablations(pd.DataFrame([*some(10), *some(30)]))
    figure = rounds_figure(summary, LOOK)
    unsafe, _, fuel, _ = figure.axes
    tuned = LOOK["refiner"].colour
    drawn = [
        next(line for line in ax.get_lines() if line.get_color() == tuned) for ax in (unsafe, fuel)
    ]
    assert drawn[0].get_xydata().tolist() == [[0, 50], [2, 10], [8, 0]]
    assert drawn[1].get_xydata() == pytest.approx(pd.DataFrame([[2, 3.0], [8, 1.0]]).to_numpy())
    assert [8, 8] in [list(line.get_xdata()) for line in unsafe.get_lines()]
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["Rule alone", "short", "tuned"]


@pytest.mark.parametrize(
    ("rule", "said", "differs"),
    [
        ((0.02, 0), "cheaper", "fuel -1.000 % [-1.000, -1.000] of the bound, +0.0 % safe"),
        ((0.02, 12), "safer and cheaper", "+30.0 % safe [+15.2, +45.4]"),
        ((0.005, 12), "safer but dearer", "+0.500 % [+0.500, "),
        ((0.01, 0), "nothing beyond chance", "0.000 % [0.000, "),
        # Of 5 trials that differ all are safe with the tuned one alone: by chance once in 16 times.
        ((0.01, 5), "nothing beyond chance", "+12.5 % safe [+1.3, +26.1]"),
    ],
)
def test_what_learning_buys_is_what_differs_beyond_chance(some, rule, said, differs):
    learning, *_ = findings(pd.DataFrame(some(rule=rule)))
    assert learning.verdict == f"n = 10: {said}, for one training"
    assert learning.numbers.startswith("n = 10: tuned's fuel ")
    assert differs in learning.numbers
    assert "Own LP: safe in 50 % " in learning.baseline


def test_a_part_is_missed_where_its_lack_is_beyond_noise(some):
    _, parts = findings(pd.DataFrame(some()))
    assert parts.verdict == "n = 10: only without what other sides say, for one training"
    assert parts.numbers.startswith("n = 10: no-third +0.800 % [+0.800, +0.800], uncrowded ")
    _, parts = findings(pd.DataFrame(some(uncrowded=0.013)))
    assert parts.verdict == "n = 10: yes, without any of them, for one training"
    _, parts = findings(pd.DataFrame(some(uncrowded=0.011)))
    assert "uncrowded -0.100 % [-0.100, -0.100]" in parts.numbers


@pytest.mark.parametrize(
    ("excess", "said", "cost"),
    [
        (0.013, "harm", "+0.100 % [+0.100, +0.100]"),
        (0.011, "help", "-0.100 % [-0.100, -0.100]"),
        (0.012, "no difference beyond noise", "0.000 % [0.000, 0.000]"),
    ],
)
def test_whether_labels_help_is_said_by_itself(some, tried, excess, said, cost):
    _, parts, labels = findings(pd.DataFrame([*some(), *tried("refiner", "labelled", excess)]))
    assert "labelled" not in parts.numbers
    assert labels.question == "Do the expert's plans as labels help the refiner to learn?"
    assert labels.verdict == f"n = 10: {said}"
    assert labels.numbers == f"n = 10: labelled {cost}"


def test_a_difference_smaller_than_the_spread_between_trainings_is_noise(some, tried):
    again = [
        *tried("refiner", "tuned", 0.010, seed=1),
        *tried("refiner", "short", 0.032, seed=1),  # ± 1.4 % from 1.2 %
        *tried("refiner", "no-third", 0.040, seed=1),
        *tried("refiner", "uncrowded", 0.032, seed=1),
    ]
    found = findings(pd.DataFrame([*some(), *again]))
    assert [one.verdict for one in found] == ["n = 10: cheaper", "n = 10: not beyond noise"]


def test_findings_part_swarm_sizes_and_families_those_of_the_paper_first(some):
    """Numbers of one family are not averaged with those of another of the same size."""
    dense = some(10, rule=(0.015, 0), family="dense")
    table = pd.DataFrame([*dense, *some(30, rule=(0.02, 12)), *some(10)])
    learning, parts = findings(table)
    assert learning.verdict == (
        "n = 10: cheaper, for one training; n = 30: safer and cheaper, for one training; "
        "dense, n = 10: cheaper, for one training"
    )
    rings, larger, crowded = learning.numbers.split("; ")
    assert rings.startswith("n = 10: tuned's fuel -1.000 % ")
    assert larger.startswith("n = 30: tuned's fuel -1.000 % ")
    assert crowded.startswith("dense, n = 10: tuned's fuel -0.500 % ")
    assert parts.verdict.count("only without what other sides say") == 3
    panels = rounds_figure(summarize_ablations(table), LOOK).axes[:3]
    assert [ax.get_title("left") for ax in panels] == ["n = 10", "n = 30", "dense, n = 10"]


def test_without_a_short_refiner_no_part_is_judged(some):
    table = pd.DataFrame(some())
    (learning,) = findings(table[table["recipe"] != "short"])
    assert learning.verdict == "n = 10: cheaper, for one training"
    assert findings(table.head(0)) == []
    elsewhere = pd.DataFrame(some(30))
    both = pd.concat([table, elsewhere[elsewhere["planner"] != "refiner"]])
    _, parts = findings(both)  # no refiner was tried at n = 30
    assert parts.numbers.startswith("n = 10: no-third")
    assert "n = 30" not in parts.numbers


def test_percentages_show_no_more_than_anyone_can_use():
    assert [percent(x) for x in (0.0, 1e-12, 0.00123, 0.5)] == ["0 %", "0 %", "0.123 %", "50.0 %"]
    assert difference(-1e-7, (-0.002, 1e-9)) == "0.000 % [-0.200, 0.000]"


def test_the_report_has_the_section_with_figure_and_tables(trials, some, tmp_path):
    table = pd.DataFrame([*some(10), *some(30), *some(10, family="dense")])
    files = build_report(Results(trials, ablations=table), tmp_path)
    text = files.markdown.read_text()
    section = text.split("## Ablations: what each idea of the refiner is worth\n\n")[1]
    assert section.startswith("Each refiner lacks one thing that *tuned* has")
    assert "ablations" in {path.stem for path in files.figures}
    by_name = {path.stem: pd.read_csv(path) for path in files.tables}
    assert {"ablations-n10", "ablations-n30", "ablations-rounds-n30"} <= set(by_name)
    assert {"ablations-dense-n10", "ablations-rounds-dense-n10"} <= set(by_name)
    assert "Refiners that lack one thing, dense, n = 10, over 40 trials, after 8 rounds" in text
    parts = by_name["ablations-n30"].set_index("name")
    assert parts.loc["no-third", "score_over_short"] == pytest.approx(0.008)
    assert "Is the refiner worse without each of its parts?" in text


def test_a_table_of_another_shape_is_refused(trials, some):
    with pytest.raises(InputError, match="'ablations' lacks the columns rounds"):
        Results(trials, ablations=pd.DataFrame(some()).drop(columns="rounds"))
