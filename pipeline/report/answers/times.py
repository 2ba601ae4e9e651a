"""Whether networks serve other transfer times, answered by the numbers of experiment 4."""

from collections.abc import Mapping, Sequence
from math import sqrt
from typing import Any

import pandas as pd

from pipeline.report.numbers import ratio, share
from pipeline.report.planners import is_network, name_of
from pipeline.report.results import PREDICTED
from pipeline.report.summary.times import WAYS, Training, of_way, trained_on

Row = Mapping[Any, Any]
Rows = Sequence[Row]
"""Averages of one planner at one transfer time; at all of them, from the shortest on."""

DEARER = 1.1
"""Factor by which fuel over bound may exceed that at the training's time: the quality is kept."""

ERRORS = 2.0
"""Standard errors by which the share of safe trials may fall short of that at the same time."""

KEPT = (
    "Quality counts as kept where fuel over bound is no more than "
    f"{100 * (DEARER - 1):.0f} % above that at the training's transfer time and the share of safe "
    f"trials no more than {ERRORS:g} standard errors below."
)


def times_answer(summary: pd.DataFrame) -> str:
    """A paragraph in Markdown: over which transfer times the safest network keeps its quality.

    Args:
        summary: from ``summarize_times``.
    """
    trained = trained_on(summary)
    question = (
        f"**Do networks trained for {trained.minutes:g} min (T = {trained.nodes}, "
        f"Δt = {trained.time_step:g} s) serve other transfer times?**"
    )
    flown = summary[summary["reading"] != PREDICTED]
    sentences = [
        f"{called} {_safest(of_way(flown, way), trained)}."
        for way, called in zip(WAYS, ("With other T", "With other Δt"), strict=True)
    ]
    return " ".join([question, *sentences, *_free(flown), KEPT])


def _safest(rows: pd.DataFrame, trained: Training) -> str:
    """What becomes of the network that is safest on average over all transfer times."""
    times = rows["minutes"].nunique()
    networks = rows[rows["planner"].map(is_network)].groupby(["planner", "recipe"])
    everywhere = networks.filter(lambda one: len(one) == times)
    if everywhere.empty or times < 2:
        return "no network took part"
    means = everywhere.groupby(["planner", "recipe"])[["safe_share", "fuel_ratio"]].mean()
    ranked = means.reset_index().sort_values(["safe_share", "fuel_ratio"], ascending=[False, True])
    planner, recipe = str(ranked["planner"].iloc[0]), str(ranked["recipe"].iloc[0])
    mine = _rows(everywhere[(everywhere.planner == planner) & (everywhere.recipe == recipe)])
    name = name_of(planner) + (f" ({recipe} recipe)" if recipe else "")
    home = [k for k, row in enumerate(mine) if row["minutes"] == trained.minutes]
    if not home:
        return f"the network that is safest on average, {name}, flown, {_range(mine)}"
    row = mine[home[0]]
    there = f"{share(row['safe_share'])} and {ratio(row['fuel_ratio'])} at {trained.minutes:g} min"
    return (
        f"the network that is safest on average, {name}, keeps its quality "
        f"{_where(mine, home[0])}: flown, it {_range(mine)}, against {there}"
    )


def _rows(of_one_planner: pd.DataFrame) -> Rows:
    return of_one_planner.sort_values("minutes").to_dict("records")


def _range(mine: Rows) -> str:
    """The worst of one planner over its transfer times."""
    least = min(mine, key=lambda row: row["safe_share"])
    dearest = max(mine, key=lambda row: row["fuel_ratio"])
    return (
        f"is safe in at least {share(least['safe_share'])} of the trials (at "
        f"{least['minutes']:.3g} min) and burns at most {ratio(dearest['fuel_ratio'])} times the "
        f"bound (at {dearest['minutes']:.3g} min)"
    )


def _where(mine: Rows, home: int) -> str:
    """The transfer times around the training's, without a gap, at which the quality is kept."""
    first = last = home
    while first > 0 and _kept(mine[first - 1], mine[home]):
        first -= 1
    while last < len(mine) - 1 and _kept(mine[last + 1], mine[home]):
        last += 1
    if last - first == len(mine) - 1:
        return "at every time tried"
    if first == last:
        return "at no other time tried"
    return f"only from {mine[first]['minutes']:.3g} to {mine[last]['minutes']:.3g} min"


def _kept(row: Row, home: Row) -> bool:
    error = sqrt(_variance(row) + _variance(home))
    safe: bool = row["safe_share"] >= home["safe_share"] - ERRORS * error
    return safe and row["fuel_ratio"] <= DEARER * home["fuel_ratio"]


def _variance(row: Row) -> float:
    """Of the share of safe trials: that of a mean of yes and no."""
    return float(row["safe_share"] * (1 - row["safe_share"]) / row["trials"])


def _free(flown: pd.DataFrame) -> list[str]:
    """What any network has to beat."""
    rows = _rows(flown[flown["planner"] == "minimum energy"])
    if not rows:
        return []
    return [f"The closed-form minimum-energy transfer, which needs no training, {_range(rows)}."]
