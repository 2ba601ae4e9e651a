"""Summary of trials: how often craft come close, how far from their goals they end, and Δv."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from pipeline.exhibits.intervals import Interval, wilson

HIGH = 0.95
"""The quantile of fields whose names end in ``high``."""


@dataclass(frozen=True)
class Summary:
    """Trials of one loop in numbers; what depends on pairs is None for a single craft.

    Separations and errors are in m, velocities and Δv of all craft in m/s. Errors at the goal are
    those of the craft furthest from its goal. Fields of replanning are None in the open loop.

    Attributes:
        loop: how they were flown.
        planner: that replanned.
        margin: asked for beyond r_col, m.
        trials: how many.
        within_radius: share in which a pair came within r_col.
        within_radius_interval: Wilson's interval of that share.
        within_size: share in which a pair came within the physical size.
        within_size_interval: Wilson's interval of that share.
        least_separation: of all trials.
        separation_median: of the least separation of each trial.
        missed_burns: mean number in a trial.
        unsafe_replans: mean number of nodes at which the plan flown was not safe from the estimate.
        replan_seconds: median time of a plan.
    """

    loop: str
    planner: str | None
    margin: float | None
    trials: int
    within_radius: float | None
    within_radius_interval: Interval | None
    within_size: float | None
    within_size_interval: Interval | None
    least_separation: float | None
    separation_median: float | None
    goal_error_median: float
    goal_error_high: float
    goal_velocity_error_median: float
    goal_velocity_error_high: float
    delta_v_median: float
    delta_v_high: float
    missed_burns: float
    unsafe_replans: float | None
    replan_seconds: float | None


def summarize(
    loop: str, planner: str | None, margin: float, rows: pa.Table, radius: float, size: float
) -> Summary:
    """The trials of a loop in numbers.

    Args:
        loop: its name.
        planner: of its planner, or None.
        margin: of it, m.
        rows: a row a trial.
        radius: r_col, m.
        size: physical size, m: the distance of two craft's centres at which they may touch.
    """
    alone = rows["min_separation"].null_count > 0
    apart = np.zeros(0) if alone else rows["min_separation"].to_numpy()
    found: dict[str, Any] = {}
    for name, distance in (("within_radius", radius), ("within_size", size)):
        share = None if alone else float((apart <= distance).mean())
        found[name] = share
        found[f"{name}_interval"] = None if share is None else wilson(share, len(apart))
    for name in ("goal_error", "goal_velocity_error", "delta_v"):
        median, high = np.quantile(rows[name].to_numpy(), [0.5, HIGH]).tolist()
        found |= {f"{name}_median": median, f"{name}_high": high}
    taken = rows["replan_seconds"].combine_chunks().flatten().to_numpy()
    return Summary(
        loop=loop,
        planner=planner,
        margin=margin if planner else None,
        trials=rows.num_rows,
        least_separation=None if alone else float(apart.min()),
        separation_median=None if alone else float(np.median(apart)),
        missed_burns=float(rows["missed_burns"].to_numpy().mean()),
        unsafe_replans=float(rows["unsafe_replans"].to_numpy().mean()) if planner else None,
        replan_seconds=float(np.median(taken)) if len(taken) else None,
        **found,
    )
