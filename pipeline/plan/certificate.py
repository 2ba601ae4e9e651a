"""The certificate of a plan: its cost, how far from optimal it can be, and how safe it is."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.orbit.fuel import fuel
from pipeline.orbit.separation import least_separation, node_collisions
from pipeline.orbit.transfer import dynamics_defect
from pipeline.scenario import Scenario

NO_FUEL = 1e-9
"""Fuel in m/s² that counts as none."""


@dataclass(frozen=True)
class Certificate:
    """What a plan is worth, all of it recomputable from the plan and its scenario.

    Attributes:
        fuel: Eq. 4, m/s².
        delta_v: time step times fuel, m/s.
        fuel_lower_bound: no transfer, safe or not, needs less, m/s².
        optimality_gap: fuel / fuel_lower_bound - 1.
        node_collisions: Eq. 5.
        min_separation: least distance of any pair at any time, m; None without a pair.
        min_separation_pair: the two craft that come closest, or None.
        min_separation_time: when, s since the start, or None.
        min_separation_bound: proven lower bound on the distance of any pair at any time, m.
        goal_error: largest miss of any component of a goal position, m.
        goal_velocity_error: largest miss of any component of a goal velocity, m/s.
        dynamics_error: largest violation of Eq. 2 in position between two nodes, m.
    """

    fuel: float
    delta_v: float
    fuel_lower_bound: float
    optimality_gap: float
    node_collisions: int
    min_separation: float | None
    min_separation_pair: tuple[int, int] | None
    min_separation_time: float | None
    min_separation_bound: float | None
    goal_error: float
    goal_velocity_error: float
    dynamics_error: float


def certify(
    scenario: Scenario,
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    fuel_lower_bound: float,
) -> Certificate:
    """The certificate of node states (m, m/s) and controls (m/s²) for a scenario."""
    problem = scenario.problem
    used = float(fuel(controls))
    closest = least_separation(states, controls, problem)
    alone = closest.pair is None
    miss = np.abs(states[:, -1] - scenario.goal)
    return Certificate(
        fuel=used,
        delta_v=used * problem.time_step,
        fuel_lower_bound=fuel_lower_bound,
        optimality_gap=gap_of(used, fuel_lower_bound),
        node_collisions=int(node_collisions(states, problem.collision_radius)),
        min_separation=None if alone else closest.distance,
        min_separation_pair=closest.pair,
        min_separation_time=closest.time,
        min_separation_bound=None if alone else closest.bound,
        goal_error=float(miss[:, :3].max()),
        goal_velocity_error=float(miss[:, 3:].max()),
        dynamics_error=float(np.abs(dynamics_defect(states, controls, problem)[..., :3]).max()),
    )


def gap_of(fuel_used: float, fuel_lower_bound: float) -> float:
    """Fuel / bound - 1; 0 where neither is more than rounding, infinite where only one is."""
    if fuel_lower_bound > NO_FUEL:
        return fuel_used / fuel_lower_bound - 1
    return 0.0 if fuel_used <= NO_FUEL else float("inf")
