"""Experiment 2: figures, tables and the verdict on the families."""

import numpy as np
import pandas as pd
import pytest
from planted import cells, trained

from pipeline.experiments.averages import summarize
from pipeline.experiments.experiment2 import (
    QUANTITIES,
    family_findings,
    fuel_findings,
    sizes_figure,
    sizes_tables,
    time_findings,
    trained_alike,
)
from pipeline.figures.style import planner_styles

COLLISIONS, FUEL = QUANTITIES["collisions"], QUANTITIES["fuel"]


def lines_of(ax, colour):
    return [line for line in ax.get_lines() if line.get_color() == colour]


def test_scaling_shows_the_averages_and_the_papers_points(trials):
    summary = summarize(trials)
    styles = planner_styles(summary["planner"])
    figure = sizes_figure(summary, COLLISIONS, styles)
    flown = next(ax for ax in figure.axes if ax.get_title(loc="left") == "paper recipe, flown")
    curve = next(x for x in lines_of(flown, styles["ff1"].colour) if len(x.get_xdata()) == 2)
    np.testing.assert_allclose(curve.get_xydata(), [[10, 1.5], [30, 1.5]])
    hollow = [x for x in flown.get_lines() if x.get_markerfacecolor() == "white"]
    points = sorted(float(x.get_ydata()[0]) for x in hollow)
    assert points == [0.113, 1.06, 1.326, 1.594, 4.64, 14.74]


def test_a_planner_unknown_to_the_paper_is_drawn_and_named(trials):
    summary = summarize(trials)
    figure = sizes_figure(summary, FUEL, planner_styles(summary["planner"]))
    names = [t.get_text() for t in figure.legends[0].get_texts()]
    assert "my net" in names
    assert "hollow: in the paper" in names


def test_two_recipes_of_a_network_whose_output_is_a_plan_are_both_drawn(rows):
    table = pd.DataFrame(
        [
            row
            for n in (10, 30)
            for recipe, fuel in (("paper", 2.0), ("tuned", 3.0))
            for row in rows("my net", recipe, "plan", n, [0], [fuel], [True])
        ]
    )
    figure = sizes_figure(summarize(table), FUEL, planner_styles(["my net"]))
    drawn = [line.get_ydata().tolist() for ax in figure.axes for line in ax.get_lines()]
    assert [2.0, 2.0] in drawn
    assert [3.0, 3.0] in drawn


def test_scaling_tables_have_a_column_for_each_size_and_no_predicted_safety(trials):
    collisions, safe, fuel = sizes_tables(summarize(trials)).values()
    header, body = cells(collisions)
    assert header[3:] == ["n = 10", "n = 30"]
    assert [r[:3] for r in body][:3] == [
        ["Expert", "", "plan"],
        ["Minimum energy", "", "plan"],
        ["FF1", "paper", "predicted"],
    ]
    assert "predicted" not in {r[2] for r in cells(safe)[1]}
    assert ["my net", "tuned", "flown", "1.060", "1.060"] in cells(fuel)[1]


def test_many_sizes_are_all_in_the_file_and_few_on_the_page(trials_at):
    table = sizes_tables(summarize(trials_at(*range(2, 31))))["collisions"]
    assert cells(table)[0][3:] == ["n = 2", "n = 5", "n = 10", "n = 20", "n = 30"]
    assert {str(n) for n in range(2, 31)} <= set(table.frame.columns)


def families(rows, forward, recurrent, seeds=2, n=30):
    """Average collisions, and fuel, of ff1 and lstm1 by training, as predicted."""
    return summarize(
        pd.DataFrame(
            [
                row
                for planner, means in (("ff1", forward), ("lstm1", recurrent))
                for seed, mean in enumerate(means[:seeds])
                for row in rows(
                    *(planner, "paper", "predicted", n, [mean] * 2, [mean] * 2, [None] * 2),
                    training_seed=seed,
                )
            ]
        )
    )


@pytest.mark.parametrize(
    ("forward", "recurrent", "verdict"),
    [
        ((4, 6), (9, 11), "Confirmed"),
        ((20, 22), (9, 11), "Contradicted"),
        ((4, 10), (9, 11), "Open: within the spread"),  # 7 ± 4.2 against 10 ± 1.4
    ],
)
def test_the_families_differ_where_they_do_beyond_the_spread_of_their_trainings(
    rows, forward, recurrent, verdict
):
    (answer,) = family_findings(families(rows, forward, recurrent))
    assert answer.verdict == verdict


def test_swarms_of_the_training_s_size_say_nothing_of_larger_ones(rows):
    ten = families(rows, (20, 22), (9, 11), n=10)
    assert family_findings(ten) == []
    (answer,) = family_findings(pd.concat([families(rows, (4, 6), (9, 11), n=5), ten]))
    assert "node collisions at n = 10" in answer.numbers


def test_families_that_were_trained_at_different_sizes_do_not_compare(rows):
    summary = families(rows, (4, 6), (9, 11))
    training = trained(*((arch, "paper", 1.0, 1.0) for arch in ("ff1", "lstm1")))
    assert len(family_findings(trained_alike(summary, training))) == 1
    assert family_findings(trained_alike(summary, training.assign(n=[3, 10]))) == []


def test_with_one_training_nothing_is_confirmed(rows):
    (answer,) = family_findings(families(rows, (4,), (9,)))
    assert answer.verdict == "Open: only one training of some; points to yes"
    (answer,) = family_findings(families(rows, (9,), (4,)))
    assert answer.verdict == "Open: only one training of some; points to no"


@pytest.mark.parametrize(
    ("forward", "recurrent", "verdict"),
    [
        ((9, 11), (4, 6), "Confirmed"),
        ((9, 11), (20, 22), "Contradicted"),
        ((9, 11), (4, 10), "Open: within the spread"),  # 7 ± 4.2 against 10 ± 1.4
        ((4,), (9,), "Open: only one training of some; points to no"),
    ],
)
def test_lstms_burn_less_where_they_do_beyond_the_spread_of_their_trainings(
    rows, forward, recurrent, verdict
):
    (answer,) = fuel_findings(families(rows, forward, recurrent))
    assert answer.question == (
        "Do LSTMs burn less fuel than feed-forward networks (n = 30), as in the paper?"
    )
    assert answer.verdict == verdict


def test_fuel_by_family_stands_beside_the_papers_at_ten_and_in_the_largest_swarm(rows):
    table = pd.concat(
        [families(rows, (9, 11), (4, 6), n=10), families(rows, (9, 11), (20, 22), n=30)]
    )
    ten, thirty = fuel_findings(table)
    assert (ten.verdict, thirty.verdict) == ("Confirmed", "Contradicted")
    # the standard deviation of two that differ by 2 is √2
    said = "LSTM1 5.00 ± 1.41 against FF1 10.0 ± 1.4 (paper: 0.76 at best against 2.98 at worst)"
    assert ten.numbers == f"fuel in m/s² at n = 10, paper recipe, as predicted: {said}"
    assert thirty.numbers.endswith("(paper: 2.24 at best against 5.71 at worst)")


def timed(rows, networks, expert):
    """Seconds of two networks of two trainings each, and of the expert, at n = 2, 10 and 30."""
    return pd.DataFrame(
        [
            made | {"seconds": seconds * (1 + made["trial"])}  # some scenarios take longer
            for planner, times in {**networks, "expert": expert}.items()
            for n, seconds in zip((2, 10, 30), times, strict=True)
            for seed in ((0,) if planner == "expert" else (0, 1))
            for made in rows(
                *(planner, "" if planner == "expert" else "paper"),
                *("plan" if planner == "expert" else "flown", n),
                *([0] * 4, [1.0] * 4, [True] * 4),
                training_seed=seed,
            )
        ]
    )


@pytest.mark.parametrize(
    ("lstm", "verdict"),
    [((2, 3, 4), "Confirmed"), ((1, 5, 60), "Contradicted by some"), ((1, 1, np.nan), "Open")],
)
def test_the_growth_of_the_networks_time_with_n_is_held_against_the_experts(rows, lstm, verdict):
    table = timed(rows, {"ff1": (1, 1, 3), "lstm1": lstm}, (1, 2, 40))
    (answer,) = time_findings(table)
    assert answer.verdict.startswith(verdict)
    if verdict == "Confirmed":
        assert answer.numbers == "from n = 2 to n = 30: networks 2.00 to 3.00 times, Expert 40.0"
    (alone,) = time_findings(table[table["training_seed"] == 0])
    assert alone.verdict == answer.verdict  # weights do not decide how long a network takes
    assert list(time_findings(table[table["n"] == 10])) == []
