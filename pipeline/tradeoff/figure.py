"""Figure of fuel against transfer time."""

from collections.abc import Sequence
from math import nan
from typing import Any

from matplotlib.figure import Figure

from pipeline.figures import style
from pipeline.plan.plan import INFEASIBLE
from pipeline.tradeoff.curve import Point

FOOT = 0.03  # height, as a share of the axes, at which durations without a safe plan are marked


@style.in_style
def tradeoff_figure(points: Sequence[Point], bend: int | None, title: str) -> Figure:
    """Plans by duration, marked at the foot where none is safe, their lower bound, and the knee."""
    figure = Figure(figsize=(style.PAGE_WIDTH, 4.0), layout="constrained")
    ax = figure.subplots()
    minutes = [point.duration / 60 for point in points]
    costs = [point.delta_v if point.safe else nan for point in points]
    bounds = [nan if p.delta_v_lower_bound is None else p.delta_v_lower_bound for p in points]
    ax.plot(minutes, costs, color="black", marker="o", label="certified plan")
    ax.plot(minutes, bounds, color=style.GREY, linestyle="--", linewidth=0.9)
    if bend is not None:
        x, y, blue = minutes[bend], costs[bend], style.INITIAL_COLOUR
        ax.plot(x, y, "o", color=blue, markersize=9, label="knee")
        said, beside = f"knee: {x:g} min, {y:.3g} m/s", (10, 10)
        ax.annotate(said, (x, y), color=blue, xytext=beside, textcoords="offset points")
    foot: dict[str, Any] = {"transform": ax.get_xaxis_transform(), "color": style.CONFLICT_COLOUR}
    infeasible = [p.duration / 60 for p in points if p.plan.status == INFEASIBLE]
    failed = [p.duration / 60 for p in points if not p.safe and p.plan.status != INFEASIBLE]
    marked = ("proven infeasible", "X", infeasible), ("no safe plan", "x", failed)
    for label, marker, times in marked:
        if times:
            ax.plot(times, [FOOT] * len(times), marker, label=label, markersize=7, **foot)
    style.fit_scale(ax, "y", [*costs, *bounds])
    if ax.get_yscale() == "linear":
        ax.set_ylim(0, ax.get_ylim()[1])
    low, high = ax.get_ylim()
    label = "below the lower bound"
    ax.fill_between(minutes, bounds, low, color="#e8e8e8", linewidth=0, label=label)
    ax.set_ylim(low, high)
    ax.set_xlabel("transfer time (min)")
    total = points[0].plan.scenario.problem.thrust.total
    ax.set_ylabel(f"Δv, {total} · Δt (m/s)")
    ax.set_title(title)
    ax.legend()
    return figure
