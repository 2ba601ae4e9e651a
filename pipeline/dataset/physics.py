"""Physics of the rows of solved shards, computed anew, and what is proven of their scenarios."""

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
from pipeline.plan import (
    INFEASIBLE,
    SOLVED,
    UNSAFE,
    UNSOLVED,
    Plan,
    Requirements,
    certify,
    gap_of,
    violations,
)
from pipeline.plan.judge import POSITION_TOLERANCE, VELOCITY_TOLERANCE
from pipeline.scenario import Scenario

STATUSES = (SOLVED, INFEASIBLE, UNSOLVED, UNSAFE)
# Columns that solved rows, and no others, have a value in, beside min_separation
PLANNED = ("states", "controls", "fuel", "fuel_lower_bound", "optimality_gap", "node_collisions")

VIOLATIONS = {
    "thrust": "breaks the thrust limit",
    "separation": "comes too close",
    "passive safety": "comes too close after a loss of thrust",
}

AT_ONCE = 100  # rows that are certified or solved at once, which bounds memory

Rows = Bool[Array, "N"]


def row_faults(
    table: pa.Table, n: int, problem: Problem, requirements: Requirements
) -> Iterator[str]:
    """Every row of a solved shard of swarm size n whose claims are wrong, with the reason."""
    faults = list(_named(table, _status_checks(table, n)))
    yield from faults
    for status, checks in ((SOLVED, _row_checks), (INFEASIBLE, _infeasible_checks)):
        rows = table.filter(pc.equal(table["status"], status))
        if not faults and rows.num_rows:
            yield from _named(rows, checks(rows, n, problem, requirements))


def _named(table: pa.Table, checks: Iterable[tuple[str, Rows]]) -> Iterator[str]:
    names = table["scenario_id"].to_pylist()
    for what, wrong in checks:
        yield from (f"{names[k]} {what}" for k in np.flatnonzero(wrong))


def _status_checks(table: pa.Table, n: int) -> Iterator[tuple[str, Rows]]:
    """Whether rows have a status, and values in the columns that it says, and in no others."""
    solved = pc.equal(table["status"], SOLVED).to_numpy()
    has = {c: table[c].is_valid().to_numpy() for c in (*PLANNED, "min_separation", "convex_solves")}
    bad = np.any([has[c] != solved for c in PLANNED], axis=0)
    bad |= has["min_separation"] != (solved & (n > 1))  # one craft is near no other
    yield "is not whole", bad | (solved & ~has["convex_solves"])
    status = np.array(table["status"].to_pylist())
    yield f"has none of the statuses {', '.join(STATUSES)}", ~np.isin(status, STATUSES)
    fewer = pc.less(table["convex_solves"], 0).fill_null(False).to_numpy()
    yield "has a negative number of convex programs", fewer


def _row_checks(
    solved: pa.Table, n: int, problem: Problem, requirements: Requirements
) -> Iterator[tuple[str, Rows]]:
    try:
        states = stacked(solved, "states", n, problem.nodes, 6)
        controls = stacked(solved, "controls", n, problem.intervals, 3)
        ends = np.stack([stacked(solved, end, n, 6) for end in ("initial", "goal")], axis=2)
    except ValueError:
        yield "has arrays of another shape", np.arange(solved.num_rows) == 0
        return
    numbers = ("fuel", "fuel_lower_bound", "optimality_gap", "node_collisions")
    claimed, bound, gap, colliding = (solved[name].to_numpy() for name in numbers)
    used, none = fuel(controls), problem.negligible_fuel
    pairs = zip(used.tolist(), bound.tolist(), strict=True)
    found = np.array([gap_of(*pair, problem) for pair in pairs])
    collisions = node_collisions(states, problem.collision_radius)
    yield "breaks the dynamics", _beyond(dynamics_defect(states, controls, problem))
    yield "misses an end", _beyond(states[:, :, [0, -1]] - ends)
    yield "has another fuel than its controls", ~np.isclose(used, claimed, rtol=1e-9, atol=0)
    yield "needs less fuel than its lower bound", ~(used >= bound * (1 - 1e-9) - none)
    yield "has a lower bound that is not 0 or more", ~(bound >= -none)
    yield "has another gap than its fuel", ~np.isclose(found, gap, rtol=0, atol=1e-9)
    yield "has other node collisions than its states", collisions != colliding
    claimed = solved["min_separation"].to_numpy(zero_copy_only=False).astype(float)
    wrong, separation, least = _judged(states, controls, ends, problem, requirements)
    beyond = bound > least * (1 + 1e-9) + none
    yield "has a lower bound above the fuel of its decoupled optima", beyond
    if n > 1:
        other = ~(np.abs(separation - claimed) <= 2 * TOLERANCE)
        yield "has another least separation than its states", other
    for what, told in VIOLATIONS.items():
        where = " at a node" * (what == "separation" and requirements.at_nodes)
        yield told + where, np.array([what in found for found in wrong])


def _infeasible_checks(
    rows: pa.Table, n: int, problem: Problem, requirements: Requirements
) -> Iterator[tuple[str, Rows]]:
    """Whether rows are proven to be infeasible, which for those that are takes no search."""
    try:
        ends = [stacked(rows, end, n, 6) for end in ("initial", "goal")]
    except ValueError:  # a fault of the scenarios
        return
    if np.isfinite(ends).all():
        scenarios = [Scenario(problem, *both) for both in zip(*ends, strict=True)]
        plans = [
            plan
            for k in range(0, len(scenarios), AT_ONCE)
            for plan in solve_many(scenarios[k : k + AT_ONCE], requirements=requirements)
        ]
        yield "is not proven to be infeasible", np.array([p.status != INFEASIBLE for p in plans])


def _beyond(error: Float[Array, "N *rest 6"]) -> Rows:
    worst = np.abs(error).max(axis=tuple(range(1, error.ndim - 1)))
    far = worst[:, :3].max(axis=1) > POSITION_TOLERANCE
    return ~np.isfinite(worst).all(axis=1) | far | (worst[:, 3:].max(axis=1) > VELOCITY_TOLERANCE)


def _judged(
    states: Float[Array, "N n T 6"],
    controls: Float[Array, "N n intervals 3"],
    ends: Float[Array, "N n 2 6"],
    problem: Problem,
    requirements: Requirements,
) -> tuple[list[dict[str, str]], Float[Array, "N"], Float[Array, "N"]]:
    """What each row violates; its least separation, m; the fuel of its decoupled optima, m/s².

    Nothing, NaN and infinite where the row is not finite, or a craft has no optimum.
    """
    kept = requirements.separation
    wrong: list[dict[str, str]] = [{} for _ in states]
    separation, least = np.full(len(states), np.nan), np.full(len(states), np.inf)
    finite = [np.isfinite(part).all(axis=(1, 2, 3)) for part in (states, controls, ends)]
    rows = np.flatnonzero(np.all(finite, axis=0))
    for some in np.array_split(rows, 1 + len(rows) // AT_ONCE) if len(rows) else ():
        scenarios = [Scenario(problem, *ends[k].swapaxes(0, 1)) for k in some]
        flown, burned = np.concatenate(states[some]), np.concatenate(controls[some])
        found = certify(scenarios, flown, burned, [(0.0, "")] * len(some), requirements)
        for scenario, k, certificate in zip(scenarios, some.tolist(), found, strict=True):
            plan = Plan(scenario, "", SOLVED, states[k], controls[k], certificate, separation=kept)
            wrong[k] = violations(plan)
            closest = certificate.min_separation
            separation[k] = np.nan if closest is None else closest
        initial, goal = np.concatenate(ends[some]).swapaxes(0, 1)
        optima = decoupled_optima(initial, goal, problem)
        feasible = optima.feasible.reshape(len(some), -1).all(axis=1)
        fuels = fuel(optima.controls.reshape(len(some), -1, *optima.controls.shape[1:]))
        least[some] = np.where(feasible, fuels, np.inf)
    return wrong, separation, least
