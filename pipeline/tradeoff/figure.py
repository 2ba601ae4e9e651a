"""The picture of a trade-off: Δv against transfer time, its lower bound, the knee."""

from collections.abc import Sequence
from math import nan
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.figures.style import (
    CONFLICT_COLOUR,
    GREY,
    INITIAL_COLOUR,
    PAGE_WIDTH,
    fit_scale,
    in_style,
)
from pipeline.plan import INFEASIBLE
from pipeline.tradeoff.curve import Point

HEIGHT = 4.0  # of the figure, inches

UNREACHED = "#e8e8e8"
"""Of what is below the lower bound."""

FOOT = 0.03  # height, as a share of the axes, at which durations without a safe plan are marked


@in_style
def tradeoff_figure(points: Sequence[Point], bend: int | None, title: str) -> Figure:
    """Plans by ascending duration and their lower bound, with the knee, if one is given.

    Durations without a safe plan are marked at the foot.
    """
    figure = Figure(figsize=(PAGE_WIDTH, HEIGHT), layout="constrained")
    ax = figure.subplots()
    minutes = [point.duration / 60 for point in points]
    costs = [point.delta_v if point.safe else nan for point in points]
    bounds = [nan if p.delta_v_lower_bound is None else p.delta_v_lower_bound for p in points]
    ax.plot(minutes, costs, color="black", marker="o", label="certified plan")
    ax.plot(minutes, bounds, color=GREY, linestyle="--", linewidth=0.9)
    if bend is not None:
        _mark_knee(ax, points[bend])
    _mark(ax, [p for p in points if p.plan.status == INFEASIBLE], "X", "thrust limit too low")
    unsafe = [p for p in points if not p.safe and p.plan.status != INFEASIBLE]
    _mark(ax, unsafe, "x", "no safe plan")
    fit_scale(ax, "y", [*costs, *bounds])
    if ax.get_yscale() == "linear":
        ax.set_ylim(0, ax.get_ylim()[1])
    low, high = ax.get_ylim()
    label = "below the lower bound"
    ax.fill_between(minutes, bounds, low, color=UNREACHED, linewidth=0, label=label)
    ax.set_ylim(low, high)
    ax.set_xlabel("transfer time (min)")
    ax.set_ylabel("Δv, Σ‖u‖₁Δt (m/s)")
    ax.set_title(title)
    ax.legend()
    return figure


def _mark_knee(ax: Axes, point: Point) -> None:
    x, y = point.duration / 60, point.delta_v
    ax.plot(x, y, "o", color=INITIAL_COLOUR, markersize=9, label="knee")
    where: dict[str, Any] = {"xytext": (10, 10), "textcoords": "offset points"}
    ax.annotate(f"knee: {x:g} min, {y:.3g} m/s", (x, y), color=INITIAL_COLOUR, **where)


def _mark(ax: Axes, points: Sequence[Point], marker: str, label: str) -> None:
    """Mark durations at the foot of the axes."""
    if points:
        ax.plot(
            [point.duration / 60 for point in points],
            [FOOT] * len(points),
            color=CONFLICT_COLOUR,
            linestyle="none",
            marker=marker,
            markersize=7,
            transform=ax.get_xaxis_transform(),
            label=label,
        )
