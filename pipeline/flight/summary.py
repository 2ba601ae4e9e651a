"""Summary and figure of trials: how close craft come, how far from their goals they end, and Δv."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.arrays import Array
from pipeline.figures import style
from pipeline.figures.intervals import Interval, wilson
from pipeline.flight.loops import Loop
from pipeline.flight.trials import Trials

HIGH = 0.95  # the quantile of fields whose names end in ``high``

LINES: Sequence[Mapping[str, Any]] = (
    {"color": style.CONFLICT_COLOUR, "linestyle": "--", "zorder": 3},
    {"color": style.INITIAL_COLOUR, "linestyle": "-.", "zorder": 4},
    {"color": style.GOAL_COLOUR, "linewidth": 3.0, "alpha": 0.5, "zorder": 2},
)
"""Of loops, in their order; the last is wide and below, since the one before may run along it."""

PANELS = {
    "min_separation": "least separation (m)",
    "goal_error": "error at the goal (m)",
    "delta_v": "Δv of all craft (m/s)",
}
"""Columns that are shown, with their axes' labels."""


@dataclass(frozen=True)
class Summary:
    """Trials of one loop in numbers; what depends on pairs is None for a single craft.

    Separations and errors are in m, velocities and Δv of all craft in m/s. Errors at the goal are
    those of the craft furthest from its goal. Fields of replanning are None in the open loop.
    """

    loop: str  # how they were flown
    planner: str | None  # that replanned
    sigmas: float | None  # standard deviations of each separation kept beyond r_col
    trials: int
    within_radius: float | None  # share in which a pair came within r_col
    within_radius_interval: Interval | None  # Wilson's of that share
    within_size: float | None  # share in which a pair came within the physical size
    within_size_interval: Interval | None  # Wilson's of that share
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


def summarize(loop: Loop, trials: Trials, radius: float, size: float) -> Summary:
    """The trials of a loop in numbers, by the collision radius and the physical size, m."""
    apart = _separations(trials)
    found: dict[str, Any] = {}
    for name, distance in (("within_radius", radius), ("within_size", size)):
        share = float((apart <= distance).mean()) if len(apart) else None
        found[name] = share
        found[f"{name}_interval"] = None if share is None else wilson(share, len(apart))
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
        least_separation=float(apart.min()) if len(apart) else None,
        separation_median=float(np.median(apart)) if len(apart) else None,
        missed_burns=float(trials["missed_burns"].mean()),
        unsafe_replans=float(trials["unsafe_replans"].mean()) if planner else None,
        replan_seconds=float(np.median(taken)) if len(taken) else None,
        **found,
    )


@style.in_style
def trials_figure(tables: Mapping[str, Trials], radius: float, size: float, title: str) -> Figure:
    """For each quantity the share of trials at or below a value, a line a loop.

    The collision radius, m, is marked, and the physical size, m, where trials come near it.
    """
    figure = Figure(figsize=(style.PAGE_WIDTH, 3.1), layout="constrained")
    panels = figure.subplots(1, len(PANELS), sharey=True)
    for ax, (column, label) in zip(panels, PANELS.items(), strict=True):
        read = _separations if column == "min_separation" else itemgetter(column)
        values = [read(trials) for trials in tables.values()]
        for loop, found, line in zip(tables, values, LINES, strict=False):
            if len(found):
                ax.ecdf(found, label=loop, **line)
        style.fit_scale(ax, "x", np.concatenate(values).tolist())
        ax.set_ylim(-0.02, 1.02)
        ax.set_xlabel(label)
    panels[0].set_ylabel("share of trials at or below")
    _mark(panels[0], radius, "r_col")
    if panels[0].get_xlim()[0] < 2 * size:
        _mark(panels[0], size, "size")
    figure.suptitle(title, x=0.01, ha="left")
    handles, labels = panels[1].get_legend_handles_labels()
    if len(tables) > 1:
        figure.legend(handles, labels, loc="outside lower center", ncols=len(tables))
    return figure


def _separations(trials: Trials) -> Float[Array, "_"]:
    """The least separation of each trial, m; none of a craft alone."""
    return trials["min_separation"][trials["first_craft"] >= 0]


def _mark(ax: Axes, distance: float, label: str) -> None:
    """A line at a distance, with its name at the top."""
    ax.axvline(distance, color=style.GREY, linewidth=0.9)
    at: dict[str, Any] = {"xycoords": ax.get_xaxis_transform(), "textcoords": "offset points"}
    ax.annotate(label, (distance, 1.0), xytext=(2, 1), color=style.GREY, fontsize=7.5, **at)
