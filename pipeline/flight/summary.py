"""Summary of trials: least separations, errors at the goal, and Δv."""

from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.figures.intervals import ConfidenceInterval, wilson
from pipeline.flight.loops import Loop
from pipeline.flight.trials import Trials

HIGH = 0.95  # the quantile of fields whose names end in ``high``


@dataclass(frozen=True)
class Summary:
    """Statistics of the trials of one loop; those of pairs are None for a single craft.

    Separations and errors are in m, velocities and Δv of all craft in m/s. Errors at the goal are
    those of the craft furthest from its goal. Fields of replanning are None in the open loop. Where
    craft have radii of their own or there are obstacles, a pair is too close by its sizes.
    """

    loop: str  # how they were flown
    planner: str | None  # that replanned
    sigmas: float | None  # standard deviations of each separation kept beyond r_col
    trials: int
    within_radius: float | None  # share in which a pair came within r_col, or too close by sizes
    within_radius_interval: ConfidenceInterval | None  # Wilson's of that share
    within_size: float | None  # share in which a pair came within the physical size
    within_size_interval: ConfidenceInterval | None  # Wilson's of that share
    least_separation: float | None  # of all trials
    separation_median: float | None  # of the least separation of each trial
    goal_error_median: float
    goal_error_high: float
    goal_velocity_error_median: float
    goal_velocity_error_high: float
    delta_v_median: float
    delta_v_high: float
    missed_burns: float  # mean number in a trial
    unsafe_replans: float | None  # mean number of nodes where the plan flown was unsafe
    replan_seconds: float | None  # median time of a plan
    # Where sizes differ or there are obstacles or corridors, else None
    least_clearance: float | None = None  # of all trials; of craft and obstacles by their sizes
    clearance_median: float | None = None  # of the least clearance of each trial
    outside_corridor: float | None = None  # share in which a craft left a corridor
    outside_corridor_interval: ConfidenceInterval | None = None  # Wilson's of that share
    least_corridor: float | None = None  # inside of corridors, of all trials
    corridor_median: float | None = None  # of the least margin of each trial

    def document(self) -> dict[str, Any]:
        """The fields for files, without those of sizes and corridors where there are none."""
        optional = {one.name for one in fields(self) if one.default is None}
        found = asdict(self).items()
        return {k: one for k, one in found if one is not None or k not in optional}


def summarize(loop: Loop, trials: Trials, radius: float, size: float) -> Summary:
    """Statistics of the trials of a loop, for a collision radius and a physical size, m."""
    apart, clear, inside = (
        finite(trials, name) for name in ("min_separation", "min_clearance", "min_margin")
    )
    found: dict[str, Any] = {}
    for name, distances, most in (
        ("within_radius", *((clear, 0.0) if "min_clearance" in trials else (apart, radius))),
        ("within_size", apart, size),
        ("outside_corridor", inside, 0.0),
    ):
        share = float((distances <= most).mean()) if len(distances) else None
        found[name] = share
        found[f"{name}_interval"] = None if share is None else wilson(share, len(distances))
    for name, distances in (("separation", apart), ("clearance", clear), ("corridor", inside)):
        found[f"least_{name}"] = float(distances.min()) if len(distances) else None
        found[f"{name}_median"] = float(np.median(distances)) if len(distances) else None
    for name in ("goal_error", "goal_velocity_error", "delta_v"):
        median, high = np.quantile(trials[name], [0.5, HIGH]).tolist()
        found |= {f"{name}_median": median, f"{name}_high": high}
    taken = trials["replan_seconds"]
    taken = taken[np.isfinite(taken)]
    planner = loop.planner
    return Summary(
        loop=loop.name,
        planner=planner.name if planner else None,
        sigmas=None if loop.back_off is None else loop.back_off.sigmas,
        trials=len(trials["trial"]),
        missed_burns=float(trials["missed_burns"].mean()),
        unsafe_replans=float(trials["unsafe_replans"].mean()) if planner else None,
        replan_seconds=float(np.median(taken)) if len(taken) else None,
        **found,
    )


def finite(trials: Trials, column: str) -> Float[Array, "_"]:
    """The finite values of a column; none where there is no such column."""
    found = trials.get(column, np.zeros(0))
    return found[np.isfinite(found)]
