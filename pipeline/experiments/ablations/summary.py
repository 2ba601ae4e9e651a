"""Trials of the ablations summed up, in the order of what is left out."""

from math import isnan

import pandas as pd

from pipeline.exhibits.intervals import Interval
from pipeline.exhibits.numbers import MISSING, number, share
from pipeline.exhibits.planners import name_of
from pipeline.experiments.answer import FREE
from pipeline.experiments.averages import Average, averaged
from pipeline.experiments.summary import COLLISIONS, SECONDS, prepared
from pipeline.networks.refiner.ablations import (
    ABLATIONS,
    LABELLED,
    NO_THIRD,
    NULL_SPACE,
    REFINER,
    RULE,
    SHORT,
    TUNED,
    UNCROWDED,
    UNSAFE,
)

LACKS = {
    TUNED: "nothing",
    SHORT: "most epochs",
    NO_THIRD: "what other sides say",
    UNCROWDED: "crowded swarms to learn from",
    LABELLED: "most epochs, but has labels",
}
"""What a refiner lacks, by its recipe; every ablation lacks most epochs, too."""

LESS_THAN_ANY = 5e-7
"""Fuel over the bound, as a share of it, under which there is none but rounding."""


def percent(value: float) -> str:
    """A share of the bound in percent, with three significant digits."""
    if isnan(value):
        return MISSING
    return "0 %" if abs(value) < LESS_THAN_ANY else f"{number(100 * value)} %"


def difference(value: float, interval: Interval) -> str:
    """A difference in percent of the bound, with its sign and interval."""
    low, high = map(_signed, interval)
    return f"{_signed(value)} % [{low}, {high}]"


def _signed(value: float) -> str:
    """In percent; more decimals are of no use to anyone."""
    text = f"{100 * value:+.3f}"
    return text.lstrip("+-") if float(text) == 0 else text


UNSAFE_SHARE = Average(
    *("Unsafe", "unsafe_share", share, "unsafe_spread", ("unsafe_low", "unsafe_high")),
    of="unsafe",
    label="unsafe trials (%)",
)
EXCESS = Average(
    *("Fuel over bound, av.", "excess_mean", percent, "excess_spread"),
    of="excess",
    label="fuel over bound, average (%)",
)
SCORE = Average(*("Score, av.", "score_mean", percent, "score_spread"), of="score")

AVERAGES = (UNSAFE_SHARE, COLLISIONS, EXCESS, SCORE, SECONDS)

GROUP = ["planner", "recipe", "family", "n", "rounds"]
"""What a row of the summary stands for."""


def scored(ablations: pd.DataFrame) -> pd.DataFrame:
    """Trials with unsafe as 1 or 0, excess, fuel over the bound less 1, and score.

    The score is what refiners are trained for: the excess, and UNSAFE more where a trial is
    unsafe. Of two planners, one with less excess may just have given way too little.
    """
    rows = prepared(ablations)
    unsafe, excess = 1 - rows["safe"], rows["fuel_ratio"] - 1
    return rows.assign(unsafe=unsafe, excess=excess, score=excess + UNSAFE * unsafe)


def summarize_ablations(ablations: pd.DataFrame) -> pd.DataFrame:
    """Averages over the trials of each planner and recipe after each number of rounds.

    Returns:
        ``GROUP``, own_rounds, name, lacks, seeds, trials and the columns of ``AVERAGES``; tuned
        and short come first, then what lacks one thing, the rule alone, and the own LP.
    """
    rows = scored(ablations)
    summary = averaged(rows, GROUP, AVERAGES)
    summary = summary.assign(
        own_rounds=int(rows["own_rounds"].iloc[0]) if len(rows) else 0,
        name=[_name(p, r) for p, r in zip(summary["planner"], summary["recipe"], strict=True)],
        lacks=[_lacks(p, r) for p, r in zip(summary["planner"], summary["recipe"], strict=True)],
        place=[_place(p, r) for p, r in zip(summary["planner"], summary["recipe"], strict=True)],
    )
    order = ["family", "n", "place", "recipe", "planner", "rounds"]
    return summary.sort_values(order, ignore_index=True).drop(columns="place")


def at_own_rounds(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows of answers as they are, with the own LP, which is what no rounds give."""
    return rows[(rows["rounds"] == rows["own_rounds"]) | (rows["planner"] == FREE)]


def _name(planner: str, recipe: str) -> str:
    if planner in (RULE, NULL_SPACE):
        return planner.replace("rule", "Rule alone")
    if not recipe:
        return name_of(planner)
    return recipe if planner == REFINER else f"{recipe} ({planner})"


def _lacks(planner: str, recipe: str) -> str:
    without = {RULE: "learning", NULL_SPACE: "learning, and programs", FREE: "rounds"}
    return without.get(planner) or LACKS.get(recipe, "")


def _place(planner: str, recipe: str) -> int:
    order, unlearned = [TUNED, SHORT, *ABLATIONS, LABELLED], [RULE, NULL_SPACE, FREE]
    if planner in unlearned:
        return len(order) + 1 + unlearned.index(planner)
    return order.index(recipe) if recipe in order else len(order)
