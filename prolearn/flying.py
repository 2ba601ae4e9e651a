"""Fly plans outside the linear model: once, or in a Monte Carlo with errors."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from matplotlib.figure import Figure

from pipeline.errors import check_kind, check_range
from pipeline.flight.effects import Effect, effects, refuse_distance
from pipeline.flight.errors import COLD_GAS, Errors
from pipeline.flight.loops import MOST_SIGMAS, SIGMAS, flight_loops, fly_loops, refuse_replanning
from pipeline.flight.summary import Summary, summarize, trials_figure
from pipeline.flight.trials import SIZE, Trials
from pipeline.flight.world import Conditions, world_of
from pipeline.plan import Plan
from pipeline.planners.planner import Planner
from pipeline.scenario.scenario import FURTHEST
from prolearn.planning import conditions_about, planner_from


def fly(plan: Plan, conditions: Conditions | None = None) -> list[Effect]:
    """Fly a plan's controls about an oblate Earth: several flights, each with one effect more.

    The first flight is the plan's own, in the linear model; the last one has all effects.

    Args:
        plan: whose controls are flown.
        conditions: reference orbit, by mean elements, and perturbations; by default a frozen,
            sun-synchronous orbit, or that of the scenario's reference. A scenario with an orbit
            has its own.

    Raises:
        InputError: where the controls lead too far away.
    """
    check_kind("plan", plan, Plan)
    check_kind("conditions", conditions, Conditions | None)
    return effects(plan.scenario, plan.controls, conditions_about(plan.scenario, conditions))


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """Trials of a plan with errors, flown in one way or several."""

    plan: Plan
    size: float  # distance of two craft's centres at which they may touch, m
    # by loop: columns of a value a trial, SI units
    trials: Mapping[str, Trials] = field(repr=False)
    summaries: tuple[Summary, ...]  # of each loop: shares with intervals, medians

    def figure(self) -> Figure:
        """For separation, error at the goal and Δv, the share of trials at or below a value."""
        asked, flown = self.plan.scenario, self.summaries[0].trials
        title = f"{asked.headline}, {flown} trials"
        return trials_figure(self.trials, asked.problem.collision_radius, self.size, title)


def monte_carlo(
    plan: Plan,
    trials: int = 100,
    *,
    errors: Errors = COLD_GAS,
    conditions: Conditions | None = None,
    replan: str | Planner | None = None,
    sigmas: float = SIGMAS,
    size: float = SIZE,
    seed: int = 0,
) -> MonteCarlo:
    """Fly a plan many times with errors of thrust, timing and navigation, in memory.

    Obstacles are flown without errors. The same seed gives the same trials; ``prolearn fly
    --trials`` flies them on several cores and keeps them in a folder.

    Args:
        plan: what is flown.
        trials: number of flights of each loop.
        errors: standard deviations; by default those of cold gas and differential GPS.
        conditions: as in ``fly``.
        replan: the planner that replans at every node, in two further loops: without and with a
            margin; or "feedback", which only corrects deviations from the plan.
        sigmas: margin of replanning, in standard deviations of each separation.
        size: distance of two craft's centres at which they may touch, m.
        seed: of the errors.

    Raises:
        InputError: for fewer than one trial, or ``replan`` where a plan cannot be replanned, as of
            a scenario with radii, obstacles, corridors, waypoints or other limits of thrust.
    """
    check_kind("plan", plan, Plan)
    check_kind("errors", errors, Errors)
    check_kind("replan", replan, str | Planner | None)
    asked = plan.scenario
    refuse_distance(asked, plan.controls)
    check_range("size", size, 0.0, FURTHEST)
    check_range("sigmas", sigmas, 0.0, MOST_SIGMAS)
    planner, with_feedback = None, replan == "feedback"
    if replan is not None:
        refuse_replanning(plan, with_feedback=with_feedback)
        planner = None if with_feedback else planner_from(replan, plan.requirements)
    world = world_of(asked, conditions_about(asked, conditions))
    loops = list(flight_loops(plan, errors, planner, sigmas, with_feedback=with_feedback))
    flown = fly_loops(asked, world, errors, loops, trials, seed)
    radius = asked.problem.collision_radius
    summaries = tuple(summarize(loop, flown[loop.name], radius, size) for loop in loops)
    return MonteCarlo(plan, size, flown, summaries)
