"""Checks of solved rows: their plans computed anew, and their infeasible scenarios proven so."""

from collections.abc import Iterable, Iterator

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from pipeline.arrays import Array, Bool, Float
from pipeline.dataset.schema import stacked
from pipeline.expert import decoupled_optima, solve_many
from pipeline.orbit.approaches import TOLERANCE
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import node_collisions
from pipeline.orbit.transfer import dynamics_defect, fuel
from pipeline.plan.certificate import certify, gap_of
from pipeline.plan.judge import POSITION_TOLERANCE, VELOCITY_TOLERANCE, violations
from pipeline.plan.plan import INFEASIBLE, SOLVED, UNSAFE, UNSOLVED, Plan
from pipeline.plan.requirements import Requirements
from pipeline.scenario import Scenario

STATUSES = (SOLVED, INFEASIBLE, UNSOLVED, UNSAFE)
# Columns with values in solved rows alone, besides min_separation
PLANNED = ("states", "controls", "fuel", "fuel_lower_bound", "optimality_gap", "node_collisions")

VIOLATIONS = {
    "thrust": "breaks the thrust limit",
    "separation": "comes too close",
    "passive safety": "comes too close after a loss of thrust",
}

AT_ONCE = 100  # rows that are certified or solved at once, which bounds memory

RowMask = Bool[Array, "N"]


def row_faults(
    table: pa.Table, n: int, problem: Problem, requirements: Requirements
) -> Iterator[str]:
    """The name of every wrong row of a solved shard of swarm size n, with what is wrong."""
    faults = list(_fault_texts(table, _status_checks(table, n)))
    yield from faults
    for status, checks in ((SOLVED, _row_checks), (INFEASIBLE, _infeasible_checks)):
        rows = table.filter(pc.equal(table["status"], status))
        if not faults and rows.num_rows:
            yield from _fault_texts(rows, checks(rows, n, problem, requirements))


def _fault_texts(table: pa.Table, checks: Iterable[tuple[str, RowMask]]) -> Iterator[str]:
    names = table["scenario_id"].to_pylist()
    for fault, is_wrong in checks:
        yield from (f"{names[k]} {fault}" for k in np.flatnonzero(is_wrong))


def _status_checks(table: pa.Table, n: int) -> Iterator[tuple[str, RowMask]]:
    """Faults of rows without a known status, or with values in other columns than it requires."""
    solved = pc.equal(table["status"], SOLVED).to_numpy()
    has = {c: table[c].is_valid().to_numpy() for c in (*PLANNED, "min_separation", "convex_solves")}
    odd = np.any([has[c] != solved for c in PLANNED], axis=0)
    odd |= has["min_separation"] != (solved & (n > 1))  # one craft has no separation
    odd |= solved & ~has["convex_solves"]
    yield "has missing values, or values that its status excludes", odd
    status = np.array(table["status"].to_pylist())
    yield f"has none of the statuses {', '.join(STATUSES)}", ~np.isin(status, STATUSES)
    negative = pc.less(table["convex_solves"], 0).fill_null(False).to_numpy()
    yield "has a negative number of convex programs", negative


def _row_checks(
    solved: pa.Table, n: int, problem: Problem, requirements: Requirements
) -> Iterator[tuple[str, RowMask]]:
    """Faults of plans, each with a mask of the rows that have it."""
    try:
        states = stacked(solved, "states", n, problem.nodes, 6)
        controls = stacked(solved, "controls", n, problem.intervals, 3)
        ends = np.stack([stacked(solved, end, n, 6) for end in ("initial", "goal")], axis=2)
    except ValueError:
        yield "has arrays of another shape", np.arange(solved.num_rows) == 0
        return
    numbers = ("fuel", "fuel_lower_bound", "optimality_gap", "node_collisions")
    claimed, bound, gap, colliding = (solved[name].to_numpy() for name in numbers)
    used, negligible = fuel(controls), problem.negligible_fuel
    pairs = zip(used.tolist(), bound.tolist(), strict=True)
    gaps = np.array([gap_of(*pair, problem) for pair in pairs])
    collisions = node_collisions(states, problem.collision_radius)
    yield "breaks the dynamics", _beyond(dynamics_defect(states, controls, problem))
    yield "misses an end", _beyond(states[:, :, [0, -1]] - ends)
    other = ~np.isclose(used, claimed, rtol=1e-9, atol=0)
    yield "claims a fuel other than that of its controls", other
    yield "has less fuel than its lower bound", ~(used >= bound * (1 - 1e-9) - negligible)
    yield "has a lower bound that is not 0 or more", ~(bound >= -negligible)
    yield "claims a gap other than that of its fuel", ~np.isclose(gaps, gap, rtol=0, atol=1e-9)
    yield "claims node collisions other than those of its states", collisions != colliding
    claimed = solved["min_separation"].to_numpy(zero_copy_only=False).astype(float)
    violated, separation, least = _recomputed(states, controls, ends, problem, requirements)
    beyond = bound > least * (1 + 1e-9) + negligible
    yield "has a lower bound above the fuel of its decoupled optima", beyond
    if n > 1:
        other = ~(np.abs(separation - claimed) <= 2 * TOLERANCE)
        yield "claims a least separation other than that of its states", other
    for requirement, fault in VIOLATIONS.items():
        where = " at a node" * (requirement == "separation" and requirements.at_nodes)
        yield fault + where, np.array([requirement in found for found in violated])


def _infeasible_checks(
    rows: pa.Table, n: int, problem: Problem, requirements: Requirements
) -> Iterator[tuple[str, RowMask]]:
    """Rows that the expert does not prove infeasible again; proofs need no search for a plan."""
    try:
        ends = [stacked(rows, end, n, 6) for end in ("initial", "goal")]
    except ValueError:  # a fault of the scenarios
        return
    if np.isfinite(ends).all():
        scenarios = [Scenario(problem, *pair) for pair in zip(*ends, strict=True)]
        plans = [
            plan
            for k in range(0, len(scenarios), AT_ONCE)
            for plan in solve_many(scenarios[k : k + AT_ONCE], requirements=requirements)
        ]
        yield "is not proven to be infeasible", np.array([p.status != INFEASIBLE for p in plans])


def _beyond(error: Float[Array, "N *rest 6"]) -> RowMask:
    worst = np.abs(error).max(axis=tuple(range(1, error.ndim - 1)))
    far = worst[:, :3].max(axis=1) > POSITION_TOLERANCE
    return ~np.isfinite(worst).all(axis=1) | far | (worst[:, 3:].max(axis=1) > VELOCITY_TOLERANCE)


def _recomputed(
    states: Float[Array, "N n T 6"],
    controls: Float[Array, "N n intervals 3"],
    ends: Float[Array, "N n 2 6"],
    problem: Problem,
    requirements: Requirements,
) -> tuple[list[dict[str, str]], Float[Array, "N"], Float[Array, "N"]]:
    """Violations of each row, its least separation, m, and the fuel of its decoupled optima, m/s².

    They are empty, NaN and infinite where a row is not finite; the last also without an optimum.
    """
    violated: list[dict[str, str]] = [{} for _ in states]
    separation, least = np.full(len(states), np.nan), np.full(len(states), np.inf)
    finite = [np.isfinite(part).all(axis=(1, 2, 3)) for part in (states, controls, ends)]
    rows = np.flatnonzero(np.all(finite, axis=0))
    for batch in np.array_split(rows, 1 + len(rows) // AT_ONCE) if len(rows) else ():
        scenarios = [Scenario(problem, *ends[k].swapaxes(0, 1)) for k in batch]
        flown, burned = np.concatenate(states[batch]), np.concatenate(controls[batch])
        found = certify(scenarios, flown, burned, [(0.0, "")] * len(batch), requirements)
        for scenario, k, certificate in zip(scenarios, batch.tolist(), found, strict=True):
            arrays, mode = (states[k], controls[k]), requirements.separation
            plan = Plan(scenario, "", SOLVED, *arrays, certificate, separation=mode)
            violated[k] = violations(plan)
            closest = certificate.min_separation
            separation[k] = np.nan if closest is None else closest
        initial, goal = np.concatenate(ends[batch]).swapaxes(0, 1)
        optima = decoupled_optima(initial, goal, problem)
        feasible = optima.feasible.reshape(len(batch), -1).all(axis=1)
        fuels = fuel(optima.controls.reshape(len(batch), -1, *optima.controls.shape[1:]))
        least[batch] = np.where(feasible, fuels, np.inf)
    return violated, separation, least
