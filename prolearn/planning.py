"""Plan scenarios, trade fuel against transfer time, and fly plans outside the linear model."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from cli.jobs.planner import planner_of
from pipeline.errors import InputError, check_kind, check_range
from pipeline.expert.settings import Effort
from pipeline.flight.effects import Effect, effects
from pipeline.flight.errors import COLD_GAS, Errors
from pipeline.flight.loops import MOST_SIGMAS, SIGMAS, TrialSettings, flight_loops, fly_loops
from pipeline.flight.summary import Summary, summarize, trials_figure
from pipeline.flight.trials import SIZE, Trials
from pipeline.flight.world import Conditions, conditions_of, in_world, world_of
from pipeline.plan.plan import Plan
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements, RiskLimit, SeparationKind
from pipeline.planners.as_flown import AsFlown
from pipeline.planners.planner import Planner, plans_of
from pipeline.scenario import Scenario, scenario_list
from pipeline.scenario import check as refuse_formations
from pipeline.scenario.scenario import FURTHEST
from pipeline.tradeoff import Goal, Point, arcs_between
from pipeline.tradeoff import tradeoff as planned_for

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plan(
    scenario: Scenario,
    planner: str | Planner = "expert",
    *,
    separation: SeparationKind = "continuous",
    passive_safety: float | None = None,
    risk: RiskLimit | None = None,
    effort: Effort | None = None,
    raw: bool = False,
    assignment: str = "given",
    allow_drift: bool = False,
    world: Conditions | bool = False,
) -> Plan:
    """A scenario's plan with its certificate; ``status`` is "solved" where it can be flown.

    Args:
        scenario: what the swarm is asked to do.
        planner: a planner's name, or a Planner object, which takes no further options.
        separation: keep craft apart at all times, or at the nodes only.
        passive_safety: also for so many orbits after any one craft has lost its thrust at a node.
        risk: the upper limit on the probability that any pair comes too close with errors, in
            open or closed loop.
        effort: as in ``planner``, and so are ``raw`` and ``assignment``.
        raw: a model's own plan.
        assignment: given or optimal.
        allow_drift: plan between states that are not on passive relative orbits, too.
        world: plan for the flight about an oblate Earth, in these conditions; True for the usual
            ones, or a scenario's own orbit.

    Raises:
        InputError: for formations in which no transfer can start or end safely.
    """
    check_kind("world", world, Conditions | bool)
    refuse_formations(scenario, allow_drift=allow_drift)
    if world:
        given = world if isinstance(world, Conditions) else None
        scenario = in_world(scenario, _conditions_about(scenario, given))
    asked = Requirements(separation, passive_safety, risk)
    options: dict[str, Any] = {"effort": effort, "raw": raw, "assignment": assignment}
    chosen = _planner_from(planner, asked, **options)
    if chosen is planner and (asked, *options.values()) != (Requirements(), None, False, "given"):
        raise InputError(
            f"the planner {chosen.name} is given with options, and has its own of these; expected "
            "a planner's name with options, or the planner alone."
        )
    return plans_of(AsFlown(chosen) if world else chosen, [scenario])[0]


def plan_all(
    scenarios: Iterable[Scenario],
    planner: str | Planner = "expert",
    *,
    allow_drift: bool = False,
) -> list[Plan]:
    """Plans of several scenarios of one problem, in order, far faster than one by one.

    States that drift are refused unless ``allow_drift``, as in ``plan``.

    Raises:
        InputError: where problems differ, or sizes for a network, and as in ``plan``.
    """
    scenarios = scenario_list(scenarios)
    for one in scenarios:
        refuse_formations(one, allow_drift=allow_drift)
    return plans_of(_planner_from(planner), scenarios)


def tradeoff(
    scenario: Scenario,
    shortest: float,
    longest: float,
    *,
    steps: int = 20,
    goal: Goal = "fixed",
    planner: str | Planner = "expert",
    allow_drift: bool = False,
) -> list[Point]:
    """A scenario planned for several transfer times, from the shortest to the longest, s.

    There are at most ``steps`` times, spread over the range. The number of thrust arcs varies, and
    their length is the scenario's time step. Goals are fixed, or slots that move on along their
    passive orbits. About an orbit that is no circle they must move, unless they may drift:
    by ``allow_drift``, as in ``plan``, or where the scenario's ends are any.

    Raises:
        InputError: for a range without a whole number of arcs, and as in ``plan``.
    """
    refuse_formations(scenario, allow_drift=allow_drift)
    arcs = arcs_between(shortest, longest, scenario.problem.time_step, steps)
    chosen = _planner_from(planner)
    return planned_for(scenario, arcs, chosen, goal, allow_drift=allow_drift)


def fly(plan: Plan, conditions: Conditions | None = None) -> list[Effect]:
    """Fly a plan's controls about an oblate Earth: several flights, each with one effect more.

    The first flight is the plan's own, in the linear model; the last one has all effects. The
    conditions are a reference orbit, by mean elements, and perturbations: by default a frozen,
    sun-synchronous orbit, or that of the scenario's reference. A scenario with an orbit has one.

    Raises:
        InputError: where the controls lead too far away.
    """
    check_kind("plan", plan, Plan)
    return effects(plan.scenario, plan.controls, _conditions_about(plan.scenario, conditions))


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """Trials of a plan with errors, flown in one way or several.

    Attributes:
        plan: what was flown.
        size: distance of two craft's centres at which they may touch, m.
        trials: by the name of the loop, columns with a value for each trial, in SI units;
            docs/flight-errors.md has the columns.
        summaries: of each loop, shares with intervals, and medians.
    """

    plan: Plan
    size: float
    trials: Mapping[str, Trials] = field(repr=False)
    summaries: tuple[Summary, ...]

    def figure(self) -> "Figure":
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
    check_range("size", size, 0.0, FURTHEST)
    check_range("sigmas", sigmas, 0.0, MOST_SIGMAS)
    size, sigmas = float(size), float(sigmas)
    planner, with_feedback = None, replan == "feedback"
    if replan is not None and not with_feedback:
        planner = _planner_from(replan, plan.requirements)
    world = world_of(asked, _conditions_about(asked, conditions))
    loops = list(flight_loops(plan, errors, planner, sigmas, with_feedback=with_feedback))
    flown = fly_loops(TrialSettings(asked, world, errors, seed), loops, trials)
    radius = asked.problem.collision_radius
    summaries = tuple(summarize(loop, flown[loop.name], radius, size) for loop in loops)
    return MonteCarlo(plan, size, flown, summaries)


def _conditions_about(scenario: Scenario, given: Conditions | None) -> Conditions:
    """The conditions given, or the usual ones; InputError beside an orbit of the scenario's own."""
    check_kind("conditions", given, Conditions | None)
    if given is not None and scenario.problem.orbit is not None:
        raise InputError(
            "there are conditions and the scenario has an orbit of its own; expected one of them: "
            "leave the conditions out (to plan, world=True is for that orbit)."
        )
    return conditions_of(scenario, given)


def _planner_from(
    given: str | Planner, requirements: Requirements = AT_ALL_TIMES, **options: Any
) -> Planner:
    """A planner object as it is, or the planner of a name with some requirements and options."""
    check_kind("planner", given, str | Planner)
    return planner_of(given, requirements, **options) if isinstance(given, str) else given
