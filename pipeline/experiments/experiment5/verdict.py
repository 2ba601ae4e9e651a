"""What a person should trust once plans are flown, by the numbers of experiment 5."""

from collections.abc import Mapping

import pandas as pd

from pipeline.exhibits.numbers import error, percents, share
from pipeline.exhibits.planners import BASELINES, EXPERTS, name_of, spoken_of
from pipeline.experiments.answer import FREE, SAFE, Answer
from pipeline.experiments.experiment5.rows import (
    LOOPS,
    MARGIN,
    NO_ERRORS,
    OPEN,
    REPLANNED,
    TYPICAL,
    WITH_ERRORS,
)
from pipeline.experiments.experiment5.summary import GOAL, WITHIN_RADIUS, summarize_flights
from pipeline.experiments.verdict import all_hold, at_most

ASKED = "plans hold outside the linear model, with errors?"

NONE = "none"
"""Of the loops."""

VERDICTS = {
    OPEN: "Yes, as they stand",
    REPLANNED: "Yes, made anew at every node",
    MARGIN: "Only made anew at every node with a margin",
    NONE: "No, not even made anew with a margin",
}
UNKNOWN, REST_UNKNOWN = "Open: too few scenarios", "Not as they stand; else too few scenarios"
"""What is said where a loop is the first that holds; where none does; where intervals are too wide
to say it of any, or of those that plan anew."""

TRUST = {
    OPEN: "Trust these plans as they stand",
    REPLANNED: "Trust a plan that is made anew at every node, even without a margin",
    MARGIN: "Trust a plan that is made anew at every node with a margin, and none as it stands",
    NONE: "Trust none of these plans outside the model that they were made in",
}
TOO_FEW = {
    UNKNOWN: "These are too few scenarios to say which plans to trust",
    REST_UNKNOWN: "Trust no plan as it stands; these are too few scenarios to say what else",
}

Holds = Mapping[str, bool | None]
"""By loop, whether a planner's plans hold, or None where intervals leave that open."""


def trusted(summary: pd.DataFrame) -> str:
    """What a person should trust: the least that all planners that coordinate craft hold with.

    Args:
        summary: from ``summarize_flights``.
    """
    planners = _coordinated(summary)
    held = [_holds(rows) for rows in planners.values()]
    together = {loop: all_hold(one.get(loop) for one in held) for loop in LOOPS}
    said = (TRUST | TOO_FEW)[_first(together)]
    numbers = "; ".join(f"{name} {_shares(rows)}" for name, rows in planners.items())
    return (
        f"{said}: about an oblate Earth, with errors of thrust and navigation, a pair comes within "
        f"the collision radius in this share of flights: {numbers}."
    )


def off_goal(summary: pd.DataFrame) -> str:
    """What brings craft off their goals, and what replanning leaves of it, for the first planner.

    Args:
        summary: from ``summarize_flights``.
    """
    name, rows = next(iter(_coordinated(summary).items()))
    alone = _coordinated(summary, NO_ERRORS)[name]
    world, errors = (_value(part, OPEN) for part in (alone, rows))
    return (
        f"{name}: in the median flight the craft furthest from its goal ends {error(world)} m off "
        f"where only the world differs, {error(errors)} m with errors, and "
        f"{error(_value(rows, REPLANNED))} m with errors and replanned."
    )


def flight_answers(flights: pd.DataFrame) -> list[Answer]:
    """A row for each planner that coordinates craft.

    Plans hold where a pair comes within the collision radius in no more than 1 - SAFE of flights,
    by the whole interval, in the world of TYPICAL with errors.

    Args:
        flights: a row a flight.
    """
    if flights.empty:
        return []
    summary = summarize_flights(flights)
    free = _typical(summary[summary["planner"] == FREE])
    beside = f"Own LP: {_shares(free)}" if len(free) else ""
    answers = []
    for name, rows in _coordinated(summary).items():
        planner = str(rows["planner"].iloc[0])
        first = _first(_holds(rows))
        said = VERDICTS.get(first, first)
        called = f"the {planner}" if planner in EXPERTS else spoken_of(planner)
        alone = _coordinated(summary, NO_ERRORS)[name]
        undisturbed = _shares(alone[alone["loop"] == OPEN])
        numbers = f"{name}, within r_col: {_shares(rows)}; without errors {undisturbed}"
        answers.append(Answer(f"Do {called}'s {ASKED}", said, numbers, beside))
    return answers


def _coordinated(summary: pd.DataFrame, errors: str = WITH_ERRORS) -> dict[str, pd.DataFrame]:
    """The rows that decide, of each planner that keeps craft apart, by its name and recipe."""
    rows = _typical(summary[~summary["planner"].isin(list(BASELINES))], errors)
    found = rows.groupby(["planner", "recipe"], sort=False)
    return {f"{name_of(str(who))} {recipe}".strip(): rows for (who, recipe), rows in found}


def _typical(summary: pd.DataFrame, errors: str = WITH_ERRORS) -> pd.DataFrame:
    return summary[(summary["world"] == TYPICAL) & (summary["errors"] == errors)]


def _value(rows: pd.DataFrame, loop: str) -> float:
    return float(rows.loc[rows["loop"] == loop, GOAL.source].iloc[0])


def _holds(rows: pd.DataFrame) -> Holds:
    most, columns = 1 - SAFE, ["loop", *(WITHIN_RADIUS.interval or ())]
    return {
        loop: at_most((low, high), most)
        for loop, low, high in rows[columns].itertuples(index=False)
    }


def _first(held: Holds) -> str:
    """The first loop that holds, NONE where all fail, or how much of that is unknown."""
    for loop in LOOPS:
        if held.get(loop):
            return loop
    if all(held.get(loop) is False for loop in LOOPS):
        return NONE
    return REST_UNKNOWN if held.get(OPEN) is False else UNKNOWN


def _shares(rows: pd.DataFrame) -> str:
    """In each loop, the share of flights in which a pair came within the collision radius."""
    columns = ["loop", WITHIN_RADIUS.source, *(WITHIN_RADIUS.interval or ())]
    return ", ".join(
        f"{share(value)} {percents(low, high)} {'in ' if loop == OPEN else ''}{loop}"
        for loop, value, low, high in rows[columns].itertuples(index=False)
    )
