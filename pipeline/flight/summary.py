"""What trials of a transfer come to: how likely craft come close, where they end, what it costs."""

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.figures.intervals import Interval, wilson

HIGH = 0.95
"""The quantile that is told beside the median."""


@dataclass(frozen=True)
class Summary:
    """Trials of one loop in numbers; what depends on pairs is None for a single craft.

    Attributes:
        loop: how they were flown.
        planner: who planned anew, or None.
        margin: asked for beyond r_col when planning anew, m; None where nobody planned anew.
        trials: how many.
        within_radius: share in which a pair came within r_col.
        within_radius_interval: Wilson's of that share.
        within_size: share in which a pair came within the physical size.
        within_size_interval: Wilson's of that share.
        least_separation: of all trials, m.
        separation_median: of the least separation of each, m.
        goal_error_median: of the craft furthest from its goal, m.
        goal_error_high: that quantile HIGH of trials stay below, m.
        goal_velocity_error_median: likewise of velocities, m/s.
        goal_velocity_error_high: m/s.
        delta_v_median: of all craft, m/s.
        delta_v_high: m/s.
        missed_burns: in a trial, on average.
        unsafe_replans: nodes of a trial, on average, at which the plan flown was not safe from
            the estimate; None where nobody planned anew.
        replan_seconds: median time of a plan; None where nobody planned anew.
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
    column = {name: rows[name].to_numpy() for name in ("goal_error", "goal_velocity_error")}
    apart = rows["min_separation"].to_numpy()
    alone = rows["min_separation"].null_count > 0
    within, within_interval = _share(apart, radius, alone=alone)
    touching, touching_interval = _share(apart, size, alone=alone)
    taken = rows["replan_seconds"].combine_chunks().flatten().to_numpy()
    goal, velocity = (np.quantile(values, [0.5, HIGH]) for values in column.values())
    used = np.quantile(rows["delta_v"].to_numpy(), [0.5, HIGH])
    return Summary(
        loop=loop,
        planner=planner,
        margin=margin if planner else None,
        trials=rows.num_rows,
        within_radius=within,
        within_radius_interval=within_interval,
        within_size=touching,
        within_size_interval=touching_interval,
        least_separation=None if alone else float(apart.min()),
        separation_median=None if alone else float(np.median(apart)),
        goal_error_median=float(goal[0]),
        goal_error_high=float(goal[1]),
        goal_velocity_error_median=float(velocity[0]),
        goal_velocity_error_high=float(velocity[1]),
        delta_v_median=float(used[0]),
        delta_v_high=float(used[1]),
        missed_burns=float(rows["missed_burns"].to_numpy().mean()),
        unsafe_replans=float(rows["unsafe_replans"].to_numpy().mean()) if planner else None,
        replan_seconds=float(np.median(taken)) if len(taken) else None,
    )


def _share(
    apart: Float[Array, "K"], distance: float, *, alone: bool
) -> tuple[float | None, Interval | None]:
    """The share of trials that come within a distance, and its interval."""
    if alone:
        return None, None
    share = float((apart <= distance).mean())
    return share, wilson(share, len(apart))
