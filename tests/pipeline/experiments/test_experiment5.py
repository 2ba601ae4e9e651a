"""Experiment 5: planted flights, small enough to count by hand."""

import pandas as pd
import pytest
from planted import cells, row

from pipeline.errors import InputError
from pipeline.experiments.experiment5 import (
    conditions_table,
    flights_figure,
    summarize_flights,
    within_table,
)
from pipeline.experiments.experiment5 import (
    findings as flight_findings,
)
from pipeline.experiments.records import LOOPS, MARGIN, OPEN, REPLANNED, WORLDS
from pipeline.figures.style import styles
from pipeline.report import Results, build_report

SCENARIOS, EACH = 100, 4


def flown(planner, world, errors, loop, close, **more):
    """Flights of all scenarios, ``close`` of which are scenarios whose flights all come close."""
    count = EACH if errors != "none" else 1
    fields = {
        "planner": planner,
        "recipe": "tuned" if planner == "refiner" else "",
        "training_seed": 0,
        "n": 10,
        "world": world,
        "errors": errors,
        "loop": loop,
        "goal_velocity_error": 0.001,
        "delta_v": 1.2,
        "delta_v_bound": 1.0,
        "missed_burns": 0,
        "unsafe_replans": float("nan") if loop == OPEN else 0.0,
        "margin": 2.0 if loop == MARGIN else 0.0,
    } | more
    return [
        fields
        | {
            "trial": trial,
            "flight": flight,
            "min_separation": 10.0 if trial < close else 20.0,
            "within_radius": trial < close,
            "within_size": False,
            "goal_error": 1.0 + flight,
        }
        for trial in range(SCENARIOS)
        for flight in range(count)
    ]


def table(**close):
    """Flights of planners, by the scenarios that come close in open loop, replanned, with margin.

    They are the same in every world; without errors none comes close.
    """
    found = []
    for planner, by_loop in close.items():
        name = planner.replace("_", " ")
        for world in WORLDS:
            for loop, count in zip(LOOPS, by_loop, strict=False):
                if loop != MARGIN:
                    found += flown(name, world, "none", loop, 0)
                found += flown(name, world, "cold gas", loop, count)
    return pd.DataFrame(found)


SAFE_ANYHOW, REPLANNING, MARGINAL, HOPELESS = (0, 0, 0), (30, 0, 0), (40, 15, 0), (40, 30, 20)
UNSURE, UNSURE_ANEW = (4, 4, 4), (40, 4, 3)


@pytest.mark.parametrize(
    ("close", "verdict"),
    [
        (SAFE_ANYHOW, "Yes, as they stand"),
        (REPLANNING, "Yes, made anew at every node"),
        (MARGINAL, "Only made anew at every node with a margin"),
        (HOPELESS, "No, not even made anew with a margin"),
        (UNSURE, "Open: too few scenarios"),
        (UNSURE_ANEW, "Not as they stand; else too few"),
    ],
)
def test_what_to_trust_is_decided_by_the_whole_interval_of_flights_that_come_close(close, verdict):
    flights = table(expert=close, decoupled_optimum=(55, 54))
    (answer,) = flight_findings(flights)
    assert answer.question == ("Do the expert's plans hold outside the linear model, with errors?")
    assert answer.verdict.startswith(verdict)
    assert answer.numbers.startswith(f"Expert, within r_col: {close[0]} % [")
    assert "; without errors 0 % [0.0, 3.7] in open loop" in answer.numbers
    assert answer.baseline.startswith("Decoupled optimum: 55 % [45.2, 64.4] in open loop, 54 %")


def test_every_planner_that_keeps_craft_apart_has_its_own_verdict():
    flights = table(expert=MARGINAL, refiner=REPLANNING, decoupled_optimum=HOPELESS[:2])
    found = {one.question.split()[2]: one for one in flight_findings(flights)}
    assert {who: one.verdict for who, one in found.items()} == {
        "expert's": "Only made anew at every node with a margin",
        "refiner's": "Yes, made anew at every node",
    }
    assert "30 % [21.9, 39.6] in open loop, 0 % [0.0, 3.7] rep" in found["refiner's"].numbers


def test_without_flights_nothing_is_answered():
    assert flight_findings(table(expert=MARGINAL).head(0)) == []


def test_errors_at_the_goal_are_those_of_the_median_flight_in_each_condition():
    flights = table(expert=MARGINAL)
    alone = (flights.errors == "none") & (flights.loop == OPEN)
    back = (flights.errors != "none") & (flights.loop == REPLANNED)
    flights.loc[alone, "goal_error"] = 0.25
    flights.loc[back, "goal_error"] = 0.5
    _, body = cells(conditions_table(summarize_flights(flights)))
    shown = {(line[2], line[3]): line[6] for line in body}
    assert shown["none", OPEN] == "0.250"
    assert shown["cold gas", OPEN] == "2.50", "flights 0 to 3 are 1, 2, 3 and 4 m off"
    assert shown["cold gas", REPLANNED] == "0.500"


def test_a_summary_counts_flights_and_an_interval_scenarios():
    flights = table(expert=MARGINAL)
    half = (flights.loop == MARGIN) & (flights.trial < 10)
    flights.loc[half & (flights.flight < 2), "within_radius"] = True
    flights.loc[half & (flights.flight == 0), "unsafe_replans"] = 3.0
    summary = summarize_flights(flights)
    found = row(summary, world="linear", errors="cold gas", loop=MARGIN)
    assert found.within_radius_share == 10 * 2 / 400
    assert found.no_plan_share == 10 / 400
    assert (found.trials, found.seeds) == (100, 1)
    # Ten scenarios of a hundred at one half: the variance of the share is 0.02273 / 100, of which
    # 209 flights are worth 0.05 · 0.95; times (1.960 / 1.984)², of Student's 99 degrees, 204.
    assert (found.within_radius_low, found.within_radius_high) == pytest.approx(
        (0.02754, 0.0891), abs=2e-5
    )
    assert (found.goal_error_median, found.goal_error_high) == (2.5, 4.0)
    assert found.delta_v_ratio == pytest.approx(1.2)
    open_loop = row(summary, world="linear", errors="cold gas", loop=OPEN)
    assert pd.isna(open_loop.no_plan_share)


def test_trainings_are_averaged_and_add_no_scenarios():
    flights = table(refiner=(40, 0, 0))
    again = flights.assign(training_seed=1, within_radius=False)
    summary = summarize_flights(pd.concat([flights, again]))
    found = row(summary, world="linear", errors="cold gas", loop=OPEN)
    assert (found.within_radius_share, found.seeds, found.trials) == (0.2, 2, 100)
    assert found.within_radius_high < 0.3


def test_tables_have_a_row_for_each_condition_and_dashes_where_nothing_was_flown():
    summary = summarize_flights(
        table(expert=MARGINAL, decoupled_optimum=(55, 54), refiner=REPLANNING)
    )
    header, body = cells(within_table(summary))
    assert header == ["World", "Errors", "Loop", "Expert", "Decoupled optimum", "Refiner tuned"]
    assert len(body) == len(WORLDS) * 5
    gas = ["linear", "cold gas"]
    assert body[:5] == [
        ["linear", "none", OPEN, *["0 % [0.0, 3.7]"] * 3],
        ["linear", "none", REPLANNED, *["0 % [0.0, 3.7]"] * 3],
        [*gas, OPEN, "40 % [30.9, 49.8]", "55 % [45.2, 64.4]", "30 % [21.9, 39.6]"],
        [*gas, REPLANNED, "15 % [9.3, 23.3]", "54 % [44.3, 63.4]", "0 % [0.0, 3.7]"],
        [*gas, MARGIN, "0 % [0.0, 3.7]", "–", "0 % [0.0, 3.7]"],
    ]
    flights = table(expert=MARGINAL, decoupled_optimum=(55, 54), refiner=REPLANNING)
    one_of_each = flights.index[flights.loop == MARGIN][:: SCENARIOS * EACH]
    flights.loc[one_of_each, "delta_v"] = 2.8  # 1.6 more in one of 400
    shown = conditions_table(summarize_flights(flights))
    _, body = cells(shown)
    assert len(shown.frame) == len(WORLDS) * 14
    assert len(body) == 14, "the page shows one world"
    expert = next(line for line in body if line[0] == "Expert" and line[3] == MARGIN)
    assert expert[2:] == [
        *("cold gas", MARGIN, "0 % [0.0, 3.7]", "20.0", "2.50", "4.00", "1.204", "2.800", "0 %"),
    ]


def test_a_figure_has_a_panel_for_each_world_and_hollow_markers_without_errors():
    summary = summarize_flights(table(expert=MARGINAL, decoupled_optimum=(55, 54)))
    look = styles(summary["planner"])
    figure = flights_figure(summary, look)
    assert len(figure.axes) == 9
    assert [ax.get_title(loc="left") for ax in figure.axes[:3]] == [
        "linear world",
        "nonlinear, e = 0.001",
        "nonlinear, e = 0.01",
    ]
    drawn = [
        (round(float(line.get_xdata()[0])), float(line.get_ydata()[0]))
        for line in figure.axes[0].get_lines()
        if line.get_color() == look["expert"].colour and line.get_markerfacecolor() != "white"
    ]
    assert drawn == [(0, 0.4), (1, 0.15), (2, 0.0)]
    hollow = [line for line in figure.axes[0].get_lines() if line.get_markerfacecolor() == "white"]
    assert len(hollow) == 4
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["Expert", "Decoupled optimum", "with errors", "without errors"]


def test_the_report_has_the_section_and_says_when_plans_hold(trials, tmp_path):
    flights = table(expert=MARGINAL, refiner=MARGINAL, decoupled_optimum=(55, 54))
    files = build_report(Results(trials, flights=flights), tmp_path)
    text = files.markdown.read_text()
    section = text.split("## Experiment 5: what flies")[1].split("\n## ")[0].strip()
    assert section.startswith("Plans hold outside the linear model where")
    assert "in no more than 5 % of flights, by the whole interval" in section
    assert "Plans of 100 test scenarios of n = 10" in section
    assert "4 times, with the same draws" in section
    assert "(2.00 m on average)" in section
    assert "Do the refiner's plans hold outside the linear model" in text.split("\n## ")[1]
    assert "experiment5.svg" in {path.name for path in files.figures}
    by_name = {path.stem: pd.read_csv(path) for path in files.tables}
    assert len(by_name["experiment5-within"]) == 15
    assert set(by_name["experiment5"]["world"]) == set(WORLDS), "the CSV file has all"


def test_a_table_of_another_shape_is_refused(trials):
    flights = table(expert=MARGINAL).drop(columns="loop")
    with pytest.raises(InputError, match=r"'flights' lacks the columns loop"):
        Results(trials, flights=flights)
