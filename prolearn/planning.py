"""Plan scenarios, and trade fuel against transfer time."""

from collections.abc import Iterable
from typing import Any

from cli.jobs.planner import planner_of
from pipeline.errors import InputError, check_each, check_kind
from pipeline.expert.settings import Effort
from pipeline.flight.world import Conditions, conditions_of, in_world
from pipeline.plan import AT_ALL_TIMES, Plan, Requirements, RiskLimit, Separation
from pipeline.planners.as_flown import AsFlown
from pipeline.planners.planner import Planner
from pipeline.scenario import Scenario
from pipeline.scenario import check as refuse_formations
from pipeline.tradeoff import Goal, Point, arcs_between
from pipeline.tradeoff import tradeoff as planned_for


def plan(
    scenario: Scenario,
    planner: str | Planner = "expert",
    *,
    separation: Separation = "continuous",
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
        scenario = in_world(scenario, conditions_about(scenario, given))
    asked = Requirements(separation, passive_safety, risk)
    options: dict[str, Any] = {"effort": effort, "raw": raw, "assignment": assignment}
    chosen = planner_from(planner, asked, **options)
    if chosen is planner and (asked, *options.values()) != (Requirements(), None, False, "given"):
        raise InputError(
            f"the planner {chosen.name} is given with options, and has its own of these; expected "
            "a planner's name with options, or the planner alone."
        )
    return (AsFlown(chosen) if world else chosen).plan([scenario])[0]


def conditions_about(scenario: Scenario, given: Conditions | None) -> Conditions:
    """The conditions given, or the usual ones; InputError beside an orbit of the scenario's own."""
    if given is not None and scenario.problem.orbit is not None:
        raise InputError(
            "there are conditions and the scenario has an orbit of its own; expected one of them: "
            "leave the conditions out (to plan, world=True is for that orbit)."
        )
    return conditions_of(scenario, given)


def plan_all(scenarios: Iterable[Scenario], planner: str | Planner = "expert") -> list[Plan]:
    """Plans of several scenarios of one problem, in order, far faster than one by one.

    Raises:
        InputError: where problems differ, or sizes for a network, and as in ``plan``.
    """
    scenarios = list(scenarios) if isinstance(scenarios, Iterable) else scenarios
    check_each("scenarios", scenarios, Scenario)
    for one in scenarios:
        refuse_formations(one)
    return planner_from(planner).plan(scenarios)


def tradeoff(
    scenario: Scenario,
    shortest: float,
    longest: float,
    *,
    steps: int = 20,
    goal: Goal = "fixed",
    planner: str | Planner = "expert",
) -> list[Point]:
    """A scenario planned for several transfer times, from the shortest to the longest, s.

    The number of thrust arcs varies, and their length is the scenario's time step.

    Args:
        scenario: planned for each time.
        shortest: transfer time, s.
        longest: transfer time, s.
        steps: times at most, spread over the range.
        goal: fixed, or moving: slots that move on along their passive orbits.
        planner: a planner's name, or a Planner object.

    Raises:
        InputError: for a range without a whole number of arcs, and as in ``plan``.
    """
    refuse_formations(scenario)
    arcs = arcs_between(shortest, longest, scenario.problem.time_step, steps)
    return planned_for(scenario, arcs, planner_from(planner), goal)


def planner_from(
    given: str | Planner, requirements: Requirements = AT_ALL_TIMES, **options: Any
) -> Planner:
    """A planner object as it is, or the planner of a name with some requirements and options."""
    check_kind("planner", given, str | Planner)
    return planner_of(given, requirements, **options) if isinstance(given, str) else given
