"""The section on experiment 5: what to trust, a figure, and tables by world, errors and loop."""

from collections.abc import Mapping

import pandas as pd

from pipeline.exhibits.blocks import Column, Picture, Table
from pipeline.exhibits.planners import BASELINES, name_of
from pipeline.exhibits.sections import Section
from pipeline.exhibits.style import Style
from pipeline.experiments.experiment5.figure import flights_figure
from pipeline.experiments.experiment5.rows import LOOPS, SIZE, TYPICAL
from pipeline.experiments.experiment5.summary import (
    CONDITION,
    DELTA_V,
    GOAL,
    GOAL_HIGH,
    MARGIN,
    MOST_DELTA_V,
    NO_PLAN,
    SEPARATION,
    WITHIN_RADIUS,
    WITHIN_SIZE,
    summarize_flights,
)
from pipeline.experiments.experiment5.verdict import off_goal, trusted
from pipeline.experiments.summary import named

TEMPLATE = "pipeline/experiments/experiment5/section.md.jinja"

CONDITIONS = [Column(name.capitalize(), name) for name in CONDITION]

COLUMNS = [
    *(Column("Planner", "name"), Column("Recipe", "recipe"), *CONDITIONS[1:], WITHIN_SIZE),
    *(SEPARATION, GOAL, GOAL_HIGH, DELTA_V, MOST_DELTA_V, NO_PLAN),
]
"""What the page shows of each planner in the usual low orbit, beside unsafe flights."""


def section(flights: pd.DataFrame, look: Mapping[str, Style]) -> Section:
    """What to trust, in a sentence; then the figure and both tables."""
    if flights.empty:
        return Section(TEMPLATE, {"flown": None})
    summary = summarize_flights(flights)
    coordinated = summary[~summary["planner"].isin(list(BASELINES))]
    values = {
        "flown": {"n": int(flights["n"].iloc[0]), "each": int(flights["flight"].max()) + 1},
        "trials": int(summary["trials"].max()),
        "trusted": trusted(summary),
        "off_goal": off_goal(summary),
        "typical": TYPICAL,
        "size": SIZE,
        "margin": coordinated.loc[coordinated["loop"] == LOOPS[-1], MARGIN.source].mean(),
        "picture": Picture("experiment5", flights_figure(summary, look)),
        "within": within_table(summary),
        "conditions": conditions_table(summary),
    }
    return Section(TEMPLATE, values)


def within_table(summary: pd.DataFrame) -> Table:
    """Flights in which a pair comes within r_col: a row a condition, a column a planner."""
    labels = [
        f"{name_of(planner)} {recipe}".strip()
        for planner, recipe in summary[["planner", "recipe"]].itertuples(index=False)
    ]
    rows = summary.assign(label=labels)
    frame, columns = rows[CONDITION].drop_duplicates(), list(CONDITIONS)
    low, high = WITHIN_RADIUS.interval or ("", "")
    for label in dict.fromkeys(labels):
        names = {WITHIN_RADIUS.source: label, low: f"{label} low", high: f"{label} high"}
        mine = rows.loc[rows["label"] == label, [*CONDITION, *names]].rename(columns=names)
        frame = frame.merge(mine, on=CONDITION, how="left")
        ends = names[low], names[high]
        columns.append(Column(label, label, WITHIN_RADIUS.text, interval=ends))
    return Table("experiment5-within", frame, columns, int(summary["seeds"].max()))


def conditions_table(summary: pd.DataFrame) -> Table:
    """All averages in all conditions; the page shows one world of them."""
    printed = summary["world"] == TYPICAL
    return Table("experiment5", named(summary), COLUMNS, int(summary["seeds"].max()), printed)
