"""The picture of a trade-off: Δv against transfer time, its lower bound, the knee."""

from collections.abc import Sequence
from math import nan
from typing import Any

from matplotlib.figure import Figure

from pipeline.figures import style
from pipeline.plan import INFEASIBLE
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
        beside: dict[str, Any] = {"xytext": (10, 10), "textcoords": "offset points"}
        ax.annotate(f"knee: {x:g} min, {y:.3g} m/s", (x, y), color=blue, **beside)
    low_thrust = [p.duration / 60 for p in points if p.plan.status == INFEASIBLE]
    failed = [p.duration / 60 for p in points if not p.safe and p.plan.status != INFEASIBLE]
    marked = {"thrust limit too low": ("X", low_thrust), "no safe plan": ("x", failed)}
    for label, (marker, times) in marked.items():
        if times:
            drawn: dict[str, Any] = {"marker": marker, "markersize": 7, "linestyle": "none"}
            drawn |= {"color": style.CONFLICT_COLOUR, "transform": ax.get_xaxis_transform()}
            ax.plot(times, [FOOT] * len(times), label=label, **drawn)
    style.fit_scale(ax, "y", [*costs, *bounds])
    if ax.get_yscale() == "linear":
        ax.set_ylim(0, ax.get_ylim()[1])
    low, high = ax.get_ylim()
    label = "below the lower bound"
    ax.fill_between(minutes, bounds, low, color="#e8e8e8", linewidth=0, label=label)
    ax.set_ylim(low, high)
    ax.set_xlabel("transfer time (min)")
    ax.set_ylabel("Δv, Σ‖u‖₁Δt (m/s)")
    ax.set_title(title)
    ax.legend()
    return figure
