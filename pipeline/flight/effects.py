"""Open-loop flights of a plan's controls with one more perturbation each, and what each adds."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import reduce
from itertools import groupby
from typing import Any

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.errors import InputError
from pipeline.flight.least_distances import LeastDistances, Surroundings
from pipeline.flight.world import Conditions, LinearWorld, World, problem_in, world_of
from pipeline.orbit.arrays import Controls, Formation, States, norm
from pipeline.orbit.nonlinear import least_after_loss_nonlinear
from pipeline.orbit.participants import Participants
from pipeline.orbit.reference import radius_at
from pipeline.orbit.separation import Separation, swarm_node_collisions
from pipeline.orbit.thrust_cost import craft_fuel
from pipeline.orbit.transfer import fly, fuel
from pipeline.plan.certificate import Clearance, CorridorMargin, PassiveSafety
from pipeline.plan.judge import POSITION_TOLERANCE, is_passively_safe
from pipeline.plan.plan import Plan
from pipeline.plan.requirements import Requirements
from pipeline.scenario import Scenario, participants
from pipeline.scenario.part_documents import OrbitDocument

PLAN = "plan"  # name of the first effect: none, the linear model of the plan
FURTHEST = 0.01  # largest distance of a plan from the origin, in radii of the reference orbit


@dataclass(frozen=True, eq=False)
class Effect:
    """A flight with one effect more than the one before.

    The share refers to the craft with the largest final position error, with all effects: it is
    the part of that error, along its direction, which the effect adds. Shares sum to 1; a negative
    one means that the effect cancels others.

    Attributes:
        name: "plan", in the linear model; then "curvature", "eccentricity", "J2", "drag".
        states: node states, LVLH, m and m/s.
        nearest: the least separation of any pair at any time: distance, m, pair, and time, s.
        errors: state at the end minus goal, m and m/s.
        added: what this effect adds to the errors; these sum to the last errors.
        share: of the effect, or None where nothing but rounding is left.
        obstacles: their node states, as they drift in that world, or are held.
        clearance: least distance of craft and obstacles less their sizes; None where all are
            alike.
        corridor: how far inside of their corridors craft stay, or None.
    """

    name: str
    states: States = field(repr=False)
    nearest: Separation
    errors: Formation = field(repr=False)
    added: Formation = field(repr=False)
    share: float | None
    obstacles: Float[Array, "m T 6"] = field(repr=False)
    clearance: Clearance | None = None
    corridor: CorridorMargin | None = None


def fly_controls(
    world: World, scenario: Scenario, controls: Controls
) -> tuple[States, Float[Array, "m T 6"], LeastDistances]:
    """Node states of craft and obstacles, and least distances, of controls (m/s²) in open loop."""
    around, nodes, met = Surroundings(scenario, world), [scenario.initial], []
    for k, control in enumerate(controls.swapaxes(0, 1)):
        arc = world.arc(nodes[-1], control, k)
        nodes.append(arc[:, -1, -1])
        met.append(around.least_distances(arc[None], k))
    return np.stack(nodes, axis=1), around.obstacles, reduce(LeastDistances.nearer, met)


def effects(scenario: Scenario, controls: Controls, conditions: Conditions) -> list[Effect]:
    """Fly a plan's controls (m/s²) with one effect more each time, up to all of the conditions.

    Effects are added in this order: curvature, two bodies on a circular orbit instead of the
    linear model; eccentricity; J2; drag. The order matters only by products of two effects, which
    are small. Effects that the conditions lack are left out. For a scenario with a reference orbit
    of its own, all that the linear model leaves out is called curvature. InputError where
    the controls lead too far away, or for conditions without a world.
    """
    problem, goal = scenario.problem, scenario.goal
    refuse_distance(scenario, controls)
    worlds = [(PLAN, LinearWorld(problem.dynamics)), *_worlds(scenario, conditions)]
    flights = [fly_controls(world, scenario, controls) for _, world in worlds]
    errors = np.stack([states[:, -1] - goal for states, _, _ in flights])
    added = np.diff(errors, axis=0, prepend=np.zeros((1, *goal.shape)))
    worst = int(norm(errors[-1, :, :3]).argmax())
    last = errors[-1, worst, :3]
    none = norm(last) <= POSITION_TOLERANCE
    shares = np.vecdot(added[:, worst, :3], last) / (1.0 if none else float(last @ last))
    given = [None if none else share for share in shares.tolist()]
    found = []
    rows = zip(worlds, flights, errors, added, given, strict=True)
    for (name, _), (states, obstacles, met), error, by, share in rows:
        least = met.craft.separation()
        clearance = Clearance.of(met.sized.separation(), scenario) if met.sized else None
        corridor = CorridorMargin.in_flight(met.inside) if met.inside else None
        effect = Effect(name, states, least, error, by, share, obstacles, clearance, corridor)
        found.append(effect)
    return found


def _worlds(scenario: Scenario, conditions: Conditions) -> Iterator[tuple[str, World]]:
    """The worlds with one more effect each, by its name."""
    if scenario.problem.orbit is not None:
        yield "curvature", world_of(scenario, conditions)
        return
    bare = replace(conditions, eccentricity=0.0, j2=False, ballistic=None)
    eccentric = replace(bare, eccentricity=conditions.eccentricity)
    steps = {
        "curvature": bare,
        "eccentricity": eccentric,
        "J2": replace(eccentric, j2=conditions.j2),
        "drag": conditions,
    }
    for one, names in groupby(steps, key=lambda name: steps[name]):
        yield next(names), world_of(scenario, one)


def refuse_distance(scenario: Scenario, controls: Controls) -> None:
    """Raise InputError for controls (m/s²) that lead a craft too far away, or are NaN."""
    problem = scenario.problem
    with np.errstate(over="ignore", invalid="ignore"):
        far = norm(fly(scenario.initial, controls, problem)[..., :3]).max(axis=1)
    most = FURTHEST * radius_at(problem.mean_motion)
    bad = ~(far <= most)
    if bad.any():
        craft = int(bad.argmax())
        raise InputError(
            f"the controls lead craft {craft} {far[craft]:.3g} m away from the reference orbit's "
            f"point; expected at most {most:.3g} m, {FURTHEST:.0%} of that orbit's radius."
        )


def flight_report(
    plan: Plan, conditions: Conditions, found: Sequence[Effect], orbits: float | None
) -> dict[str, Any]:
    """The last flight, with all effects, and under ``effects`` each of them; SI units.

    Errors at the goal are those of the craft that misses by most. Separations are None for a craft
    alone. ``safe`` is whether craft and obstacles stay apart, at all times or at the nodes as the
    plan required, and after a loss of thrust where ``orbits`` are given, and craft stay inside
    their corridors.
    """
    problem, last = plan.scenario.problem, found[-1]
    used, limits = float(fuel(plan.controls)), plan.scenario.limits
    if limits is not None:
        used = float(craft_fuel(plan.controls, problem.thrust, limits).sum())
    drift = None if orbits is None else _passive_safety(plan, conditions, last.states, orbits)
    collisions = _node_collisions(plan.scenario, last) if plan.separation == "nodes" else None
    if collisions is not None:
        safe = collisions == 0
    elif last.clearance is not None:
        safe = last.clearance.min_clearance_bound > 0
    else:
        safe = last.nearest.bound > problem.collision_radius
    safe &= last.corridor is None or last.corridor.min_margin_bound > 0
    safe &= drift is None or is_passively_safe(drift, problem.collision_radius)
    return {
        "planner": plan.planner,
        "status": plan.status,
        "separation": plan.separation,
        "safe": safe,
        "collision_radius": problem.collision_radius,
        **({} if collisions is None else {"node_collisions": collisions}),
        "conditions": OrbitDocument.of(world_of(plan.scenario, conditions).orbit).model_dump(),
        "fuel": used,
        "delta_v": used * problem.time_step,
        **_of(last),
        "passive_safety": None if drift is None else drift.document(),
        "goal_error_craft": int(norm(last.errors[:, :3]).argmax()),
        "goal_errors": last.errors.tolist(),
        "effects": [
            {
                "effect": one.name,
                "added_error": _most(one.added[:, :3]),
                "added_velocity_error": _most(one.added[:, 3:]),
                "share": one.share,
                **_of(one),
            }
            for one in found
        ],
    }


def _node_collisions(scenario: Scenario, last: Effect) -> int:
    """Number of node collisions: pairs of participants that are too close, counted node by node."""
    swarms = participants([scenario])
    if isinstance(swarms, Participants):
        swarms.states = last.obstacles
    radius = scenario.problem.collision_radius
    return int(swarm_node_collisions(last.states, radius, swarms)[0])


def _passive_safety(
    plan: Plan, conditions: Conditions, states: States, orbits: float
) -> PassiveSafety:
    """Passive safety in the world of a flight: least distances after a loss of thrust."""
    Requirements(passive_safety=orbits)  # refuses what is no number of orbits
    scenario = plan.scenario
    flown = states, plan.controls, problem_in(scenario.problem, conditions), orbits
    adrift = least_after_loss_nonlinear(*flown)
    spaced = adrift
    if scenario.sized:
        spaced = least_after_loss_nonlinear(*flown, participants([scenario]))
    return PassiveSafety.of(orbits, adrift, Clearance.of(spaced, scenario))


def _of(effect: Effect) -> dict[str, Any]:
    nearest = effect.nearest
    alone = nearest.pair is None
    unlike = {"clearance": effect.clearance, "corridor": effect.corridor}
    return {
        "goal_error": _most(effect.errors[:, :3]),
        "goal_velocity_error": _most(effect.errors[:, 3:]),
        "min_separation": None if alone else nearest.distance,
        "min_separation_pair": nearest.pair,
        "min_separation_time": nearest.time,
        "min_separation_bound": None if alone else nearest.bound,
        **{name: asdict(one) for name, one in unlike.items() if one is not None},
    }


def _most(errors: Float[Array, "n 3"]) -> float:
    return float(np.max(norm(errors)))
