"""What became of a plan that was flown, by field names and in SI units."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.flight.conditions import Conditions
from pipeline.flight.effects import Effect
from pipeline.orbit.bezier import norm
from pipeline.orbit.fuel import fuel
from pipeline.orbit.separation import node_collisions
from pipeline.plan import Plan
from pipeline.scenario import Scenario


def flight_report(
    plan: Plan, scenario: Scenario, conditions: Conditions, found: Sequence[Effect]
) -> dict[str, Any]:
    """The last flight, with all effects, and under ``effects`` each of them.

    Errors at the goal are distances, of the craft that misses by most. Separations are None for a
    craft alone. It is safe where craft stay apart when the plan was to keep them apart, at all
    times or at the nodes.
    """
    problem, last = scenario.problem, found[-1]
    used = float(fuel(plan.controls))
    safe = last.flight.nearest.bound > problem.collision_radius
    if plan.separation == "nodes":
        safe = node_collisions(last.flight.states, problem.collision_radius) == 0
    return {
        "planner": plan.planner,
        "status": plan.status,
        "separation": plan.separation,
        "safe": safe,
        "collision_radius": problem.collision_radius,
        "conditions": asdict(conditions),
        "fuel": used,
        "delta_v": used * problem.time_step,
        **_of(last),
        "goal_error_craft": int(norm(last.errors[:, :3]).argmax()),
        "goal_errors": last.errors.tolist(),
        "effects": [_effect(one) for one in found],
    }


def _of(effect: Effect) -> dict[str, Any]:
    """How far off the goal a flight ended, and how close craft came."""
    nearest = effect.flight.nearest
    alone = nearest.pair is None
    return {
        "goal_error": _most(effect.errors[:, :3]),
        "goal_velocity_error": _most(effect.errors[:, 3:]),
        "min_separation": None if alone else nearest.distance,
        "min_separation_pair": nearest.pair,
        "min_separation_time": nearest.time,
        "min_separation_bound": None if alone else nearest.bound,
    }


def _effect(effect: Effect) -> dict[str, Any]:
    return {
        "effect": effect.name,
        "added_error": _most(effect.added[:, :3]),
        "added_velocity_error": _most(effect.added[:, 3:]),
        "share": effect.share,
        **_of(effect),
    }


def _most(errors: Float[Array, "n 3"]) -> float:
    return float(np.max(norm(errors)))
