"""Trials averaged over scenarios and over training seeds."""

import pandas as pd

from pipeline.exhibits.planners import in_order
from pipeline.experiments.compare import share_interval
from pipeline.experiments.paper import NETWORK_SIZE
from pipeline.experiments.trials import FLOWN, PLAN, PREDICTED

GROUP = ["planner", "recipe", "reading", "n"]
"""What a row of the summary stands for."""

NO_FUEL = 1e-9
"""A bound in m/s² below which fuel / bound says nothing."""

RECIPES = ["", "paper", "tuned"]
READINGS = [PLAN, PREDICTED, FLOWN]

SPREAD = {
    "collisions_mean": "collisions_spread",
    "safe_share": "safe_spread",
    "fuel_mean": "fuel_spread",
    "fuel_ratio": "fuel_ratio_spread",
}
"""By column of the summary, the one that holds its spread over the training seeds."""


def summarize(trials: pd.DataFrame) -> pd.DataFrame:
    """Averages over the trials of each planner, recipe, reading and n, in reading order.

    A network that was trained with several seeds has one row, the average of its trainings; the
    spread is the standard deviation between them.

    Returns:
        ``GROUP`` and seeds (trainings averaged), trials, collisions_mean, collisions_max,
        conflicts_mean, safe_share (NaN where predicted), separation_min (m), fuel_mean (m/s²),
        bound_mean, fuel_ratio (mean over the trials of fuel / bound), boundary_error and
        dynamics_error (mean, m), seconds_mean, convex_solves_mean, the columns of ``SPREAD`` (NaN
        where there is one training), safe_low and safe_high (Wilson's interval of the share).
    """
    rows = trials.assign(
        recipe=trials["recipe"].fillna(""),
        safe=as_share(trials["safe"]).where(trials["reading"] != PREDICTED),
        fuel_ratio=fuel_ratio(trials),
    )
    each = rows.groupby([*GROUP, "training_seed"], as_index=False, sort=False).agg(
        trials=("trial", "nunique"),
        collisions_mean=("node_collisions", "mean"),
        collisions_max=("node_collisions", "max"),
        conflicts_mean=("pair_conflicts", "mean"),
        safe_share=("safe", "mean"),
        separation_min=("min_separation", "min"),
        fuel_mean=("fuel", "mean"),
        bound_mean=("fuel_lower_bound", "mean"),
        fuel_ratio=("fuel_ratio", "mean"),
        boundary_error=("boundary_error", "mean"),
        dynamics_error=("dynamics_error", "mean"),
        seconds_mean=("seconds", "mean"),
        convex_solves_mean=("convex_solves", "mean"),
    )
    return _ordered(_over_seeds(each))


def reference_size(trials: pd.DataFrame) -> int:
    """The paper's n=10, or the size nearest to it that has trials (the smaller of two)."""
    sizes = sorted(int(n) for n in trials["n"].unique())
    return min(sizes, key=lambda n: abs(n - NETWORK_SIZE))


def fuel_ratio(trials: pd.DataFrame) -> "pd.Series[float]":
    """Fuel over its bound in each trial; NaN where the bound is none."""
    bound = trials["fuel_lower_bound"].astype(float)
    return trials["fuel"].astype(float) / bound.where(bound > NO_FUEL)


def as_share(safe: "pd.Series[bool]") -> "pd.Series[float]":
    """1 where safe, 0 where not or not claimed."""
    return safe.astype("boolean").fillna(False).astype(float)


def _over_seeds(each: pd.DataFrame) -> pd.DataFrame:
    """One row for the trainings that differ in their seed alone."""
    extremes = {"trials": "max", "collisions_max": "max", "separation_min": "min"}
    values = [c for c in each.columns if c not in (*GROUP, "training_seed")]
    groups = each.groupby(GROUP, as_index=False, sort=False)
    summary = groups.agg({c: extremes.get(c, "mean") for c in values})
    summary.insert(len(GROUP), "seeds", groups["training_seed"].nunique()["training_seed"])
    spread = groups[list(SPREAD)].std().rename(columns=SPREAD)
    summary = summary.assign(**{column: spread[column] for column in SPREAD.values()})
    return with_interval(summary, "safe_share", "safe")


def with_interval(summary: pd.DataFrame, column: str, name: str) -> pd.DataFrame:
    """Wilson's interval of a share of the trials, as columns ``name``_low and ``name``_high.

    Trainings with other seeds flew the same trials, so they add none.
    """
    pairs = zip(summary[column].astype(float), summary["trials"], strict=True)
    found = [share_interval(share, int(trials)) for share, trials in pairs]
    return summary.assign(
        **{f"{name}_low": [low for low, _ in found], f"{name}_high": [high for _, high in found]}
    )


def _ordered(summary: pd.DataFrame) -> pd.DataFrame:
    planners = in_order(summary["planner"])
    ranks = {"planner": planners, "recipe": RECIPES, "reading": READINGS}

    def rank(column: "pd.Series[str]") -> "pd.Series[int]":
        order = ranks.get(str(column.name))
        if order is None:
            return column.astype(int)
        return column.map(lambda v: order.index(v) if v in order else len(order)).astype(int)

    return summary.sort_values(GROUP, key=rank, ignore_index=True, kind="stable")
