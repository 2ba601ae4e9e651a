"""Experiment 2: figures, tables and the verdict on the families."""

import numpy as np
import pandas as pd
import pytest
from planted import cells

from pipeline.experiments.averages import summarize
from pipeline.experiments.experiment2 import (
    QUANTITIES,
    family_findings,
    sizes_figure,
    sizes_tables,
)
from pipeline.figures.style import styles

COLLISIONS, FUEL = QUANTITIES["collisions"], QUANTITIES["fuel"]


def lines_of(ax, colour):
    return [line for line in ax.get_lines() if line.get_color() == colour]


def test_scaling_shows_the_averages_and_the_papers_points(trials):
    summary = summarize(trials)
    look = styles(summary["planner"])
    figure = sizes_figure(summary, COLLISIONS, look)
    flown = next(ax for ax in figure.axes if ax.get_title(loc="left") == "paper recipe, flown")
    curve = next(x for x in lines_of(flown, look["ff1"].colour) if len(x.get_xdata()) == 2)
    np.testing.assert_allclose(curve.get_xydata(), [[10, 1.5], [30, 1.5]])
    hollow = [x for x in flown.get_lines() if x.get_markerfacecolor() == "white"]
    points = sorted(float(x.get_ydata()[0]) for x in hollow)
    assert points == [0.113, 1.06, 1.326, 1.594, 4.64, 14.74]


def test_a_planner_unknown_to_the_paper_is_drawn_and_named(trials):
    summary = summarize(trials)
    figure = sizes_figure(summary, FUEL, styles(summary["planner"]))
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
    figure = sizes_figure(summarize(table), FUEL, styles(["my net"]))
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


def families(rows, forward, recurrent, seeds=2):
    """Average collisions of ff1 and lstm1 by training, at n = 30 as predicted."""
    return summarize(
        pd.DataFrame(
            [
                row
                for planner, means in (("ff1", forward), ("lstm1", recurrent))
                for seed, mean in enumerate(means[:seeds])
                for row in rows(
                    *(planner, "paper", "predicted", 30, [mean] * 2, [1.0] * 2, [None] * 2),
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


def test_with_one_training_nothing_is_confirmed(rows):
    (answer,) = family_findings(families(rows, (4,), (9,)))
    assert answer.verdict == "Open: one training of some, points to yes"
    (answer,) = family_findings(families(rows, (9,), (4,)))
    assert answer.verdict == "Open: one training of some, points to no"
