"""Averages: each defined once, for the summary, its CSV file and the tables on the page."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from pipeline.exhibits.blocks import Column
from pipeline.exhibits.intervals import wilson
from pipeline.exhibits.numbers import count


@dataclass(frozen=True)
class Average(Column):
    """A column of a summary: the trials of each training first, then the trainings.

    ``source`` is its name there. ``spread``, the standard deviation between trainings, and
    ``interval``, Wilson's of a share, become columns beside it where they are named.

    Attributes:
        of: column of the trials.
        how: how the trials of one training become one number.
        over: how the trainings that differ in their seed alone do.
        label: of an axis that shows it.
    """

    of: str = ""
    how: "str | Callable[[pd.Series[Any]], object]" = "mean"
    over: "str | Callable[[pd.Series[Any]], object]" = "mean"
    label: str = ""


TRIALS = Average("Trials", "trials", count, of="trial", how="nunique", over="max")


def averaged(rows: pd.DataFrame, group: Sequence[str], averages: Sequence[Average]) -> pd.DataFrame:
    """One row for the trials of each group.

    Args:
        rows: a row each trial, with column training_seed.
        group: columns that a row of the summary stands for.
        averages: its further columns, beside trials and seeds (trainings averaged).
    """
    averages = (TRIALS, *averages)
    each = rows.groupby([*group, "training_seed"], as_index=False, sort=False).agg(
        **{a.source: (a.of, a.how) for a in averages}
    )
    summary = over_trainings(each, group, averages)
    for share in (a for a in averages if a.interval):
        # Trainings with other seeds flew the same trials, so they add none.
        pairs = zip(summary[share.source].astype(float), summary["trials"], strict=True)
        summary[list(share.interval or ())] = [wilson(s, int(k)) for s, k in pairs]
    return summary


def over_trainings(
    each: pd.DataFrame, group: Sequence[str], averages: Sequence[Average]
) -> pd.DataFrame:
    """One row for the trainings that differ in their seed alone, spreads last.

    Args:
        each: a row each training, with columns training_seed and ``source`` of the averages.
        group: columns that a row stands for.
        averages: its further columns, beside seeds (trainings averaged).
    """
    groups = each.groupby(list(group), as_index=False, sort=False)
    found = groups.agg({a.source: a.over for a in averages})
    found.insert(len(group), "seeds", groups["training_seed"].nunique()["training_seed"])
    spreads = {a.source: a.spread for a in averages if a.spread}
    found[list(spreads.values())] = groups[list(spreads)].std()[list(spreads)]
    return found
