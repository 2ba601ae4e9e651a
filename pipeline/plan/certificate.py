"""The certificate of a plan: its cost, how far from optimal it can be, and how safe it is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.orbit.approaches import Swarms, side_by_side
from pipeline.orbit.bezier import norm
from pipeline.orbit.problem import Problem
from pipeline.orbit.risk import collision_risk
from pipeline.orbit.separation import least_separations, swarm_node_collisions
from pipeline.orbit.transfer import dynamics_defect
from pipeline.plan.passive_safety import PassiveSafety, passive_safety
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements
from pipeline.plan.risk import Risk, RiskLimit
from pipeline.scenario import Scenario, shared_problem

FINE = 1e-9
"""Width in m of the bracket of a least separation that is as good as the collision radius."""


@dataclass(frozen=True)
class Certificate:
    """What a plan is worth, all of it recomputable from the plan and its scenario.

    Attributes:
        fuel: Eq. 4, m/s².
        delta_v: time step times fuel, of all craft, m/s.
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
        fuel_lower_bound_proof: how the bound is proven, in words.
        risk: what is claimed of errors in open loop, where that was asked for, or None.
        passive_safety: how close craft come after a loss of thrust, where that was asked for.
        craft_delta_v: of each craft, ΔtΣₜ‖u[t]‖₁, m/s; they sum to delta_v. Thrusters along the
            three axes have to provide it. Earlier files have none.
        craft_delta_v_2norm: of each craft, ΔtΣₜ‖u[t]‖₂, m/s: of one thruster that is turned.
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
    fuel_lower_bound_proof: str = ""
    risk: Risk | None = None
    passive_safety: PassiveSafety | None = None
    craft_delta_v: tuple[float, ...] = ()
    craft_delta_v_2norm: tuple[float, ...] = ()


def certify(
    scenarios: Sequence[Scenario],
    states: Float[Array, "N T 6"],
    controls: Float[Array, "N intervals 3"],
    bounds: Sequence[tuple[float, str]],
    requirements: Requirements = AT_ALL_TIMES,
) -> list[Certificate]:
    """The certificates of node states (m, m/s) and controls (m/s²), craft after craft.

    Args:
        scenarios: of one problem.
        states: of all their craft.
        controls: of all their craft.
        bounds: lower bound on the fuel of each scenario, m/s², and how it is proven.
        requirements: what was asked; passive safety and risk are claimed only where they were.
    """
    problem, swarms = shared_problem(scenarios), side_by_side(tuple(s.n for s in scenarios))
    each = np.abs(controls).sum(axis=(1, 2))
    used = np.add.reduceat(each, swarms.starts)
    spent = [
        np.split(problem.time_step * of, swarms.starts[1:])
        for of in (each, norm(controls).sum(axis=1))
    ]
    closest = least_separations(states, controls, problem, swarms)
    for k, apart in enumerate(closest):
        if apart.bound <= problem.collision_radius < apart.distance:  # undecided
            craft = np.flatnonzero(swarms.label == k)
            alone = states[craft], controls[craft], problem, side_by_side((len(craft),))
            closest[k] = least_separations(*alone, tolerance=FINE)[0]
    miss = np.abs(states[:, -1] - np.concatenate([s.goal for s in scenarios]))
    misses = np.maximum.reduceat(miss, swarms.starts)
    defect = np.abs(dynamics_defect(states, controls, problem)[..., :3]).max(axis=(1, 2))
    defects = np.maximum.reduceat(defect, swarms.starts)
    collisions = swarm_node_collisions(states, problem.collision_radius, swarms)
    adrift: Sequence[PassiveSafety | None] = [None] * len(scenarios)
    if requirements.passive_safety is not None:
        adrift = passive_safety(states, controls, problem, requirements.passive_safety, swarms)
    risks: Sequence[Risk | None] = [None] * len(scenarios)
    if requirements.risk is not None:
        risks = _risks(states, controls, problem, requirements.risk, swarms)
    return [
        Certificate(
            fuel=float(used[k]),
            delta_v=float(used[k]) * problem.time_step,
            fuel_lower_bound=bound,
            optimality_gap=gap_of(float(used[k]), bound, problem),
            node_collisions=int(collisions[k]),
            min_separation=None if apart.pair is None else apart.distance,
            min_separation_pair=apart.pair,
            min_separation_time=apart.time,
            min_separation_bound=None if apart.pair is None else apart.bound,
            goal_error=float(misses[k, :3].max()),
            goal_velocity_error=float(misses[k, 3:].max()),
            dynamics_error=float(defects[k]),
            fuel_lower_bound_proof=proof,
            risk=risks[k],
            passive_safety=adrift[k],
            craft_delta_v=tuple(spent[0][k].tolist()),
            craft_delta_v_2norm=tuple(spent[1][k].tolist()),
        )
        for k, ((bound, proof), apart) in enumerate(zip(bounds, closest, strict=True))
    ]


def _risks(
    states: Float[Array, "N T 6"],
    controls: Float[Array, "N intervals 3"],
    problem: Problem,
    limit: RiskLimit,
    swarms: Swarms,
) -> list[Risk]:
    """The risk of flying each of several swarms in open loop."""
    errors, ends = limit.uncertainty(problem), swarms.starts[1:]
    parts = zip(np.split(states, ends), np.split(controls, ends), strict=True)
    bounds = [collision_risk(*part, problem, errors).total for part in parts]
    return [Risk(bound, limit.asked, errors, sigmas=0.0, fuel_without=None) for bound in bounds]


def gap_of(fuel_used: float, fuel_lower_bound: float, problem: Problem) -> float:
    """Fuel / bound - 1; 0 where neither is more than rounding, infinite where only one is."""
    if fuel_lower_bound > problem.negligible_fuel:
        return fuel_used / fuel_lower_bound - 1
    return 0.0 if fuel_used <= problem.negligible_fuel else float("inf")
