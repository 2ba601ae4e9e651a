"""Summary and figure of trials: least separations, errors at the goal, and Δv."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.figures import style
from pipeline.figures.intervals import ConfidenceInterval, wilson
from pipeline.flight.loops import Loop
from pipeline.flight.trials import Trials

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HIGH = 0.95  # the quantile of fields whose names end in ``high``

LINES: Sequence[Mapping[str, Any]] = (
    {"color": style.CONFLICT_COLOUR, "linestyle": "--", "zorder": 3},
    {"color": style.INITIAL_COLOUR, "linestyle": "-.", "zorder": 4},
    {"color": style.GOAL_COLOUR, "linewidth": 3.0, "alpha": 0.5, "zorder": 2},
)
"""Of loops, in their order; the last is wide and below, since the one before may run along it."""

APART = {"min_separation": "least separation (m)"}
CLEAR = {"min_clearance": "least clearance (m)"}  # instead, where sizes are not alike
PANELS = {"goal_error": "error at the goal (m)", "delta_v": "Δv of all craft (m/s)"}
"""Axis labels of the columns that are plotted."""


@dataclass(frozen=True)
class Summary:
    """Statistics of the trials of one loop; those of pairs are None for a single craft.

    Separations and errors are in m, velocities and Δv of all craft in m/s. Errors at the goal are
    those of the craft furthest from its goal. Fields of replanning are None in the open loop. Where
    craft have radii of their own or there are obstacles, a pair is too close by its sizes.
    The last six fields are None unless sizes differ or there are obstacles or corridors.

    Attributes:
        loop: how they were flown.
        planner: that replanned.
        sigmas: standard deviations of each separation kept beyond r_col.
        trials: number of trials.
        within_radius: share in which a pair came within r_col, or too close by sizes.
        within_radius_interval: Wilson's of that share.
        within_size: share in which a pair came within the physical size.
        within_size_interval: Wilson's of that share.
        least_separation: of all trials.
        separation_median: of the least separation of each trial.
        goal_error_median: of the position error of each trial.
        goal_error_high: 95th percentile of it.
        goal_velocity_error_median: of the velocity error of each trial.
        goal_velocity_error_high: 95th percentile of it.
        delta_v_median: of the Δv of each trial.
        delta_v_high: 95th percentile of it.
        missed_burns: mean number in a trial.
        unsafe_replans: mean number of nodes where the plan flown was unsafe.
        replan_seconds: median time of a plan, s.
        least_clearance: of all trials; of craft and obstacles by their sizes.
        clearance_median: of the least clearance of each trial.
        outside_corridor: share in which a craft left a corridor.
        outside_corridor_interval: Wilson's of that share.
        least_corridor: least margin inside of corridors of all trials.
        corridor_median: of the least margin of each trial.
    """

    loop: str
    planner: str | None
    sigmas: float | None
    trials: int
    within_radius: float | None
    within_radius_interval: ConfidenceInterval | None
    within_size: float | None
    within_size_interval: ConfidenceInterval | None
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
    least_clearance: float | None = None
    clearance_median: float | None = None
    outside_corridor: float | None = None
    outside_corridor_interval: ConfidenceInterval | None = None
    least_corridor: float | None = None
    corridor_median: float | None = None

    def document(self) -> dict[str, Any]:
        """The fields for files, without those of sizes and corridors where there are none."""
        optional = {one.name for one in fields(self) if one.default is None}
        found = asdict(self).items()
        return {k: one for k, one in found if one is not None or k not in optional}


def summarize(loop: Loop, trials: Trials, radius: float, size: float) -> Summary:
    """Statistics of the trials of a loop, for a collision radius and a physical size, m."""
    apart, clear, inside = (
        _finite(trials, name) for name in ("min_separation", "min_clearance", "min_margin")
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


@style.in_style
def trials_figure(tables: Mapping[str, Trials], radius: float, size: float, title: str) -> "Figure":
    """Empirical distribution of each quantity over the trials, a line for each loop.

    The collision radius, m, is marked, and the physical size, m, where trials come near it. Where
    craft have radii of their own or there are obstacles, clearance takes the place of separation.
    """
    from matplotlib.figure import Figure  # slow to import, and only figures need it

    figure = Figure(figsize=(style.PAGE_WIDTH, 3.1), layout="constrained")
    clear = any("min_clearance" in trials for trials in tables.values())
    shown = {**(CLEAR if clear else APART), **PANELS}
    panels = figure.subplots(1, len(shown), sharey=True)
    for ax, (column, label) in zip(panels, shown.items(), strict=True):
        values = [_finite(trials, column) for trials in tables.values()]
        for loop, found, line in zip(tables, values, LINES, strict=False):
            if len(found):
                ax.ecdf(found, label=loop, **line)
        if column not in CLEAR:  # which may be negative
            style.fit_scale(ax, "x", np.concatenate(values).tolist())
        ax.set_ylim(-0.02, 1.02)
        ax.set_xlabel(label)
    panels[0].set_ylabel("share of trials at or below")
    _mark(panels[0], 0.0 if clear else radius, "clear" if clear else "r_col")
    if not clear and panels[0].get_xlim()[0] < 2 * size:
        _mark(panels[0], size, "size")
    figure.suptitle(title, x=0.01, ha="left")
    handles, labels = panels[1].get_legend_handles_labels()
    if len(tables) > 1:
        figure.legend(handles, labels, loc="outside lower center", ncols=len(tables))
    return figure


def _finite(trials: Trials, column: str) -> Float[Array, "_"]:
    """The finite values of a column; none where there is no such column."""
    found = trials.get(column, np.zeros(0))
    return found[np.isfinite(found)]


def _mark(ax: "Axes", distance: float, label: str) -> None:
    """A line at a distance, with its name at the top."""
    ax.axvline(distance, color=style.GREY, linewidth=0.9)
    at: dict[str, Any] = {"xycoords": ax.get_xaxis_transform(), "textcoords": "offset points"}
    ax.annotate(label, (distance, 1.0), xytext=(2, 1), color=style.GREY, fontsize=7.5, **at)
