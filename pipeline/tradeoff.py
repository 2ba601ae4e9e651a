"""Fuel against transfer time: plans of several durations, the curve's knee, and its figure.

The number of thrust arcs varies and their length, the scenario's time step, does not: longer arcs
waste fuel, for the same ten minutes ten of 60 s need some 10 % less than five of 120 s.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, floor, isfinite, nan
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.errors import InputError, check_choice, check_whole, is_number
from pipeline.figures import style
from pipeline.orbit.problem import MOST_NODES
from pipeline.plan.plan import INFEASIBLE, SOLVED, Plan
from pipeline.planners.planner import Planner, plans_of
from pipeline.progress import SILENT, Progress
from pipeline.scenario import Scenario
from pipeline.scenario.validation import DRIFTING, drifts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# fixed: the goal states for every duration; moving: states on the passive orbits that reach these
# after the scenario's own duration
Goal = Literal["fixed", "moving"]

FEWEST = 2  # arcs of the shortest transfer that reaches a goal state in all six components
ROUNDING = 1e-9  # share of an arc by which a duration may miss a whole number of them
BENT = 0.1  # least distance of a knee below the chord of the normalised curve
LESS = 0.5  # largest ratio of the fuel saved per time after a knee to that before it
FOOT = 0.03  # height, as a share of the axes, at which durations without a safe plan are marked


@dataclass(frozen=True, eq=False)
class Point:
    """The plan for one transfer time."""

    plan: Plan

    @property
    def duration(self) -> float:
        """Duration of the transfer, s."""
        return self.plan.scenario.problem.duration

    @property
    def safe(self) -> bool:
        """Whether the plan can be flown."""
        return self.plan.status == SOLVED

    @property
    def delta_v(self) -> float:
        """Δv of the plan, all craft, m/s."""
        return self.plan.certificate.delta_v

    @property
    def delta_v_lower_bound(self) -> float | None:
        """No plan of this duration needs less, m/s; None where it is proven that there is none."""
        if self.plan.status == INFEASIBLE:
            return None
        return self.plan.certificate.fuel_lower_bound * self.plan.scenario.problem.time_step


def arcs_between(first: float, last: float, time_step: float, steps: int) -> list[int]:
    """At most ``steps`` numbers of arcs over a range of durations, s; InputError if none fits."""
    check_whole("steps", steps, 1, MOST_NODES)
    if not all(is_number(one) and isfinite(one / time_step) for one in (first, last)):
        raise InputError(f"duration is {first} to {last} s; expected finite numbers.")
    first, last = float(first), float(last)
    least, most = ceil(first / time_step - ROUNDING), floor(last / time_step + ROUNDING)
    if least < FEWEST:
        raise InputError(
            f"duration begins at {first:g} s; expected at least {FEWEST * time_step:g} s, which is "
            f"{FEWEST} thrust arcs of the scenario's time_step: begin later or lower time_step."
        )
    if most < least:
        raise InputError(
            f"duration is {first:g} to {last:g} s; expected a range with a multiple of time_step, "
            f"{time_step:g} s, in it: widen it or lower time_step."
        )
    if most >= MOST_NODES:
        raise InputError(
            f"duration ends at {last:g} s; expected less than {MOST_NODES * time_step:g} s, which "
            f"is {MOST_NODES} thrust arcs of the scenario's time_step: end earlier."
        )
    spread = np.linspace(least, most, steps) if steps > 1 else [most]
    return sorted({round(float(arcs)) for arcs in spread})


def with_arcs(
    scenario: Scenario, arcs: int, goal: Goal = "fixed", *, allow_drift: bool = False
) -> Scenario:
    """The scenario with another number of control intervals; a moving goal drifts until their end.

    InputError where that is too short for waypoints and corridors or, unless ``allow_drift`` or the
    ends are any, where fixed goals drift at their new time, as they do unless about a circle.
    """
    problem = replace(scenario.problem, nodes=arcs + 1)
    check_choice("goal", goal, get_args(Goal))
    waypoints = [one.time + problem.time_step for one in scenario.waypoints if one.time is not None]
    needed = max([*waypoints, *(one.end for one in scenario.corridors)], default=0.0)
    if problem.duration < needed * (1 - ROUNDING):
        raise InputError(
            f"a transfer of {problem.duration:g} s is asked for, and the scenario's waypoints and "
            f"corridors take {needed:g} s; expected at least so much: begin later, or leave these "
            "out."
        )
    if goal == "fixed":
        fixed = replace(scenario, problem=problem)
        passive = problem.orbit is not None and scenario.ends == "passive" and not allow_drift
        if passive and drifts(fixed):
            raise InputError(
                f"a transfer of {problem.duration:g} s is asked for, and about this orbit craft at "
                "the goals drift then; expected none that do: let goals move (--goal moving, in "
                f'Python goal="moving"), or {DRIFTING}.'
            )
        return fixed
    A = problem.dynamics.drift(scenario.problem.intervals, arcs)
    return replace(scenario, problem=problem, goal=scenario.goal @ A.T)


def tradeoff(
    scenario: Scenario,
    arcs: Sequence[int],
    planner: Planner,
    goal: Goal = "fixed",
    progress: Progress = SILENT,
    *,
    allow_drift: bool = False,
) -> list[Point]:
    """The plans for some numbers of thrust arcs, in that order; progress is told of each."""
    asked = [with_arcs(scenario, number, goal, allow_drift=allow_drift) for number in arcs]
    progress.expect(len(arcs))
    points = []
    for one in asked:
        (plan,) = plans_of(planner, [one])
        points.append(Point(plan))
        progress.done()
    return points


def knee(time: Float[Array, "points"], cost: Float[Array, "points"]) -> int | None:
    """The point furthest below the chord of the normalised curve, by its number, or None.

    The criterion of Kneedle (V. Satopää, J. Albrecht, D. Irwin, B. Raghavan, "Finding a 'Kneedle'
    in a Haystack", ICDCS Workshops 2011), without its smoothing: times and costs are scaled to
    0..1, and the knee is where the curve is furthest from the line between its ends. Only points
    that cost less than every faster one count, since the others are no trade-off.

    Every curve has such a point, so one is called a knee only where it is a tenth below that line,
    and where time saves at most half as much after it as before it, on average. Times ascend.
    """
    faster = np.minimum.accumulate(np.concatenate([[np.inf], cost]))[:-1]
    efficient = np.flatnonzero(cost < faster)
    if len(efficient) < 3:  # none is between two others
        return None
    x, y = time[efficient], cost[efficient]
    below = 1 - (x - x[0]) / (x[-1] - x[0]) - (y - y[-1]) / (y[0] - y[-1])
    bend = int(below.argmax())
    if below[bend] < BENT:
        return None
    before = (y[0] - y[bend]) / (x[bend] - x[0])
    after = (y[bend] - y[-1]) / (x[-1] - x[bend])
    return int(efficient[bend]) if after <= LESS * before else None


def knee_of(points: Sequence[Point]) -> int | None:
    """The knee among the safe plans, by its number among all of the points, or None."""
    safe = [k for k, point in enumerate(points) if point.safe]
    time, cost = ([getattr(points[k], name) for k in safe] for name in ("duration", "delta_v"))
    found = knee(np.array(time, dtype=float), np.array(cost, dtype=float))
    return None if found is None else safe[found]


@style.in_style
def tradeoff_figure(points: Sequence[Point], bend: int | None, title: str) -> "Figure":
    """Plans by duration, marked at the foot where none is safe, their lower bound, and the knee."""
    from matplotlib.figure import Figure  # slow to import, and only figures need it

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
