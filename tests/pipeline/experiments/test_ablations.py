"""Ablations: planted numbers of refiners, the rule and the decoupled optimum."""

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
LOOK = styles(["refiner", "rule", "decoupled optimum"])


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
            *tried("decoupled optimum", "", 0.0, 20, rounds=0, **on),
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
    own = row(summary, planner="decoupled optimum")
    assert (own["score_mean"], own["rounds"]) == (pytest.approx(0.05), 0)


def test_rows_stand_in_the_order_of_what_is_left_out(some):
    table = pd.DataFrame(some())
    _, body = cells(parts_table("n = 10", scored(table), summarize_ablations(table)))
    names = ["tuned", "short", "no-third", "uncrowded", "Rule alone"]
    assert [line[0] for line in body] == [*names, "Decoupled optimum"]
    assert [line[1] for line in body][-2:] == ["learning", "rounds"]
    assert body[2] == [
        *("no-third", "messages of other encounters", "0 % [0.0, 8.8]", "0", "2.00 %"),
        *("+0.800 % [+0.800, +0.800]", "0.250"),
    ]
    assert body[1][5] == "–"
    assert body[-1][2] == "50 % [35.2, 64.8]", "Wilson of 20 in 40"
    assert body[-1][5].startswith("+3.800 % "), "5 % for half of the trials, less 1.2 %"


def test_the_table_of_rounds_begins_with_the_decoupled_optimum_for_all(some):
    header, body = cells(rounds_table("n = 10", summarize_ablations(pd.DataFrame(some()))))
    assert header == ["Refiner", "Rounds", "Unsafe", "Fuel over bound, av."]
    half = "50 % [35.2, 64.8]"
    assert body == [
        ["tuned", "0", half, "0 %"],
        ["tuned", "2", "10 % [4.0, 23.1]", "3.00 %"],
        ["tuned", "8", "0 % [0.0, 8.8]", "1.00 %"],
        ["short", "0", half, "0 %"],
        ["short", "8", "0 % [0.0, 8.8]", "1.20 %"],
        ["Rule alone", "0", half, "0 %"],
        ["Rule alone", "2", "25 % [14.2, 40.2]", "4.00 %"],
        ["Rule alone", "8", "0 % [0.0, 8.8]", "2.00 %"],
    ]


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


def asked(table):
    """Verdict and numbers by what the refiner is asked to be worse without."""
    return {
        one.question.removeprefix("Is the refiner worse ").rstrip("?"): (one.verdict, one.numbers)
        for one in findings(pd.DataFrame(table))
    }


SIDES, CROWDS = "without messages of other encounters", "without crowded swarms to learn from"
RULE_ALONE = "without learning, by its rule alone"


def test_a_part_is_missed_where_its_lack_is_beyond_noise(some):
    found = asked(some())
    assert found[SIDES] == ("n = 10: yes", "n = 10: score +0.800 % [+0.800, +0.800]")
    assert found[CROWDS] == ("n = 10: open: within noise", "n = 10: score 0.000 % [0.000, 0.000]")
    assert found[RULE_ALONE] == ("n = 10: yes", "n = 10: score +0.800 % [+0.800, +0.800]")
    better = asked(some(uncrowded=0.011))[CROWDS]
    assert better == ("n = 10: no, better", "n = 10: score -0.100 % [-0.100, -0.100]")


def test_an_unsafe_trial_counts_in_what_learning_is_worth(some):
    """12 of 40 trials of the rule are unsafe: 3 % of the bound in the mean."""
    verdict, numbers = asked(some(rule=(0.005, 12)))[RULE_ALONE]
    assert verdict == "n = 10: yes"
    assert numbers.startswith("n = 10: score +2.300 % [")


def test_a_difference_smaller_than_the_spread_between_trainings_is_noise(some, tried):
    again = [
        *tried("refiner", "tuned", 0.010, seed=1),
        *tried("refiner", "short", 0.032, seed=1),  # ± 1.4 % from 1.2 %
        *tried("refiner", "no-third", 0.040, seed=1),
        *tried("refiner", "uncrowded", 0.032, seed=1),
    ]
    found = asked([*some(), *again])
    assert found[SIDES][0] == found[CROWDS][0] == "n = 10: open: within noise"


def test_findings_part_swarm_sizes_and_families_those_of_the_paper_first(some):
    """Numbers of one family are not averaged with those of another of the same size."""
    dense = some(10, rule=(0.015, 0), family="dense")
    table = pd.DataFrame([*dense, *some(30, rule=(0.042, 0)), *some(10)])
    verdict, numbers = asked(table)[RULE_ALONE]
    assert verdict == "n = 10: yes; n = 30: yes; dense, n = 10: yes"
    rings, larger, crowded = numbers.split("; ")
    assert rings.startswith("n = 10: score +0.800 % ")
    assert larger.startswith("n = 30: score +3.000 % ")
    assert crowded.startswith("dense, n = 10: score +0.300 % ")
    panels = rounds_figure(summarize_ablations(table), LOOK).axes[:3]
    assert [ax.get_title("left") for ax in panels] == ["n = 10", "n = 30", "dense, n = 10"]


def test_without_a_short_refiner_no_part_is_judged(some):
    table = pd.DataFrame(some())
    assert asked(table[table["recipe"] != "short"]) == asked(table.head(0)) == {}
    elsewhere = pd.DataFrame(some(30))
    both = pd.concat([table, elsewhere[elsewhere["planner"] != "refiner"]])
    assert asked(both)[SIDES][0] == "n = 10: yes", "no refiner was tried at n = 30"


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
    assert "Is the refiner worse without messages of other encounters?" in text


def test_a_table_of_another_shape_is_refused(trials, some):
    with pytest.raises(InputError, match="'ablations' lacks the columns rounds"):
        Results(trials, ablations=pd.DataFrame(some()).drop(columns="rounds"))
