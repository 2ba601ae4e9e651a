"""Experiment 4: planted numbers at three transfer times either way."""

import numpy as np
import pandas as pd
import pytest
from planted import cells, flown, shares, trained

from pipeline.experiments.experiment4 import (
    findings as times_findings,
)
from pipeline.experiments.experiment4 import (
    grid_of_data,
    recipes_of,
    rows_varying,
    summarize_times,
    times_figure,
    times_tables,
)
from pipeline.figures.style import planner_styles
from pipeline.report import Results, build_report

GRIDS = {6: 10, 11: 20, 21: 40}


STEPS = {60.0: 10, 120.0: 20, 240.0: 40}
"""Minutes by T at 120 s, and by Δt at T = 11."""


@pytest.fixture
def times_at(rows):
    """The LSTM's fuel over bound and safe trials of 4 by minutes; the others are constant."""

    def made(fuel, safe, grids=tuple(GRIDS), steps=tuple(STEPS)):
        def at(varied, nodes, step, minutes):
            here = [
                *rows("expert", "", "plan", 10, [0] * 4, [1.0] * 4, [True] * 4),
                *rows("minimum energy", "", "plan", 10, [1] * 4, [1.3] * 4, [True, *[False] * 3]),
            ]
            kept = [k < safe[minutes] for k in range(4)]
            for reading in ("predicted", "flown"):
                here += rows("lstm1", "tuned", reading, 10, [2] * 4, [fuel[minutes]] * 4, kept)
                if nodes == 11:
                    here += rows("ff1", "paper", reading, 10, [3] * 4, [9.0] * 4, [False] * 4)
            return [row | {"varied": varied, "nodes": nodes, "time_step": step} for row in here]

        return pd.DataFrame(
            [row for T in grids for row in at("nodes", T, 120.0, GRIDS[T])]
            + [row for step in steps for row in at("time_step", 11, step, STEPS[step])]
        )

    return made


@pytest.fixture
def times(times_at):
    return times_at({10: 1.25, 20: 1.2, 40: 3.5}, {10: 4, 20: 4, 40: 2})


def test_the_grid_of_the_data_is_where_the_two_ways_meet(times):
    assert grid_of_data(times) == (11, 120.0)


def test_planners_keep_the_order_of_the_other_tables_though_some_fit_one_time_alone(times):
    summary = summarize_times(times)
    order = list(dict.fromkeys(summary["planner"]))
    assert order == ["expert", "minimum energy", "ff1", "lstm1"]
    assert (summary["trials"] == 4).all()
    ff1 = summary[(summary.planner == "ff1") & (summary.reading == "flown")]
    assert list(zip(ff1.varied, ff1.minutes, strict=True)) == [
        ("nodes", 20),
        ("time_step", 10),
        ("time_step", 20),
        ("time_step", 40),
    ]


def test_tables_have_both_ways_and_dashes_where_a_network_does_not_fit(times):
    collisions, safe, fuel = times_tables(summarize_times(times)).values()
    header, body = cells(fuel)
    assert header[3:] == [
        "10 min, T = 6",
        "20 min, T = 11",
        "40 min, T = 21",
        "10 min, Δt = 60 s",
        "20 min, Δt = 120 s",
        "40 min, Δt = 240 s",
    ]
    by_row = {tuple(row[:3]): row[3:] for row in body}
    assert by_row["LSTM1", "tuned", "flown"] == ["1.250", "1.200", "3.500"] * 2
    assert by_row["FF1", "paper", "flown"] == ["–", "9.000", "–", "9.000", "9.000", "9.000"]
    assert "predicted" not in {row[2] for row in cells(safe)[1]}
    assert ["Expert", "", "plan", *["0"] * 6] in cells(collisions)[1]


def test_a_figure_has_both_ways_side_by_side_and_marks_the_training(times):
    summary = summarize_times(times)
    styles = planner_styles(summary["planner"])
    assert recipes_of(summary) == ["paper", "tuned"]
    figure = times_figure(summary, "tuned", styles)
    assert len(figure.axes) == 6
    fuel = figure.axes[4:]
    assert [ax.get_xlabel() for ax in fuel] == ["transfer time (min)"] * 2
    for ax in fuel:
        drawn = {line.get_color(): line.get_xydata().tolist() for line in ax.get_lines()}
        assert drawn[styles["lstm1"].colour] == [[10, 1.25], [20, 1.2], [40, 3.5]]
        assert [20, 20] in [list(line.get_xdata()) for line in ax.get_lines()]
    assert "FF1" not in [t.get_text() for t in figure.legends[0].get_texts()]
    paper = times_figure(summary, "paper", styles).axes[4]
    (alone,) = (x for x in paper.get_lines() if x.get_color() == styles["ff1"].colour)
    assert alone.get_xydata().tolist() == [[20, 9.0]]


def test_a_way_without_the_trainings_own_time_borrows_it_from_the_other(times_at):
    table = times_at({10: 1.2, 20: 1.2, 40: 1.2}, {10: 4, 20: 4, 40: 4}, steps=(60.0, 240.0))
    summary = summarize_times(table)
    minutes = rows_varying(summary, "time_step")["minutes"]
    assert set(minutes) == {10, 20, 40}


def test_without_networks_one_figure_is_still_there(times):
    summary = summarize_times(times[times.planner.isin(["expert", "minimum energy"])])
    assert recipes_of(summary) == [""]
    assert len(times_figure(summary, "", planner_styles(summary["planner"])).axes) == 6


def test_several_trainings_show_their_average_and_spread(times):
    again = times[times.planner == "lstm1"].assign(training_seed=1)
    summary = summarize_times(pd.concat([times, again.assign(fuel=again.fuel + 2)]))
    _, body = cells(times_tables(summary)["fuel"])
    flown = {tuple(row[:3]): row[3:] for row in body}
    assert flown["LSTM1", "tuned", "flown"][0] == "2.250 ± 1.414"  # 1.25 and 3.25
    assert flown["Expert", "", "plan"][0] == "1.000"
    (band,) = times_figure(summary, "tuned", planner_styles(summary["planner"])).axes[4].collections
    low, high = band.get_datalim(band.axes.transData).intervaly
    assert (low, high) == pytest.approx((2.2 - 2**0.5, 4.5 + 2**0.5))


def test_the_report_has_the_section_with_figures_and_tables(trials_at, times, tmp_path):
    files = build_report(Results(trials_at(6), transfer_times=times), tmp_path)
    text = files.markdown.read_text()
    section = text.split("## Experiment 4: other transfer times")[1].split("\n## ")[0]
    assert "feed-forward networks have 6nT inputs and outputs" in section
    assert {"experiment4-paper", "experiment4-tuned"} <= {p.stem for p in files.figures}
    by_name = {p.stem: pd.read_csv(p, keep_default_na=False) for p in files.tables}
    safe = by_name["experiment4-safe"].set_index("planner")
    assert float(safe.loc["lstm1", "40 min, T = 21"]) == 0.5
    assert np.isnan(pd.to_numeric(safe.loc["ff1", "40 min, T = 21"]))


def test_transfer_times_that_hardly_differ_are_told_apart(times):
    near = times.replace({"time_step": {60.0: 119.99999, 240.0: 120.00001}})
    header, _ = cells(times_tables(summarize_times(near))["fuel"])
    steps = ["119.99999", "120", "120.00001"]
    assert header[6:] == [f"20 min, Δt = {step} s" for step in steps]
    _, other = times_findings(near, trained(("lstm1", "tuned", 0.5, 1.0)))
    assert "(20.000002 min)" in other.numbers, "of 4, 4 and 2 safe trials, the last is the worst"


def lstms_at(rows, safe, fuel):
    """lstm1's safe trials of 100 and fuel over bound by minutes; ff1 fits 20 min alone."""
    grids = [("nodes", T, 120.0, m) for T, m in ((6, 10), (11, 20), (21, 40))]
    grids += [("time_step", 11, step, m) for step, m in ((60.0, 10), (120.0, 20), (240.0, 40))]
    table = []
    for varied, nodes, step, minutes in grids:
        kept = [k < safe[minutes] for k in range(100)]
        here = flown(rows, "lstm1", "tuned", kept, fuel[minutes])
        here += flown(rows, "decoupled optimum", "", shares(50, 100), 1.0, reading="plan")
        here += flown(rows, "ff1", "tuned", kept, 1.0) if nodes == 11 else []
        table += [row | {"varied": varied, "nodes": nodes, "time_step": step} for row in here]
    return pd.DataFrame(table)


CHEAP = dict.fromkeys((10, 20, 40), 1.05)


@pytest.mark.parametrize(
    ("safe", "fuel", "verdict"),
    [
        # Wilson's interval of 100 in 100 begins at 96.3 %, that of 99 at 94.6 %.
        ({10: 100, 20: 100, 40: 100}, CHEAP, "Yes, wherever tried: 10 min to 40 min"),
        (
            {10: 99, 20: 100, 40: 100},
            CHEAP,
            "At 20 min, 40 min; open, with too few trials: 10 min",
        ),
        ({10: 99, 20: 99, 40: 30}, CHEAP, "Open, with too few trials: 10 min, 20 min"),
        ({10: 100, 20: 30, 40: 100}, CHEAP, "Only at 10 min, 40 min"),
        ({10: 100, 20: 100, 40: 100}, {**CHEAP, 10: 1.2, 40: 1.2}, "Only at 20 min"),
        ({10: 50, 20: 30, 40: 50}, CHEAP, "No"),
    ],
)
def test_a_transfer_time_is_served_where_plans_are_proven_safe_and_cheap(rows, safe, fuel, verdict):
    training = trained(("ff1", "tuned", 0.9, 1.0), ("lstm1", "tuned", 0.5, 1.0))
    nodes, steps = times_findings(lstms_at(rows, safe, fuel), training)
    assert "trained for transfers of 20 min work with other nodes T" in nodes.question
    assert nodes.verdict == verdict
    assert nodes.numbers.startswith("LSTM1 tuned, the only one that fits: at worst safe in ")
    assert steps.numbers.startswith("FF1 tuned, best on validation of those"), (
        "at other time steps the better one fits, too"
    )
    assert nodes.baseline.startswith("Decoupled optimum: at worst safe in 50 % ")


def test_of_a_refiner_it_is_not_said_for_which_transfer_time_it_was_trained(rows):
    """A refiner can be evaluated on any time grid, not only that of its training."""
    times = lstms_at(rows, {10: 100, 20: 100, 40: 100}, CHEAP)
    times["planner"] = times["planner"].replace("lstm1", "refiner")
    said = times_findings(
        times, trained(("ff1", "tuned", 0.9, 1.0), ("refiner", "tuned", 0.9, 1.0))
    )
    asked = [one.question for one in said if "refiner" in one.question]
    assert asked == [
        "Does the refiner work with other nodes T than the data's?",
        "Does the refiner work with other time steps Δt than the data's?",
    ]
