"""Checks of the rows of solved shards against physics, computed anew from their arrays."""

from collections.abc import Iterator

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Bool, Float

from pipeline.arrays import Array
from pipeline.dataset.manifest import requirements_of
from pipeline.dataset.schema import (
    SCENARIO_FIELDS,
    SOLVED_FIELDS,
    problem_of,
    scenarios_of,
    stacked,
)
from pipeline.errors import InputError
from pipeline.orbit.approaches import TOLERANCE
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import node_collisions
from pipeline.orbit.transfer import dynamics_defect, fuel
from pipeline.plan import SOLVED, Plan, Requirements, certify, violations
from pipeline.plan.judge import POSITION_TOLERANCE, VELOCITY_TOLERANCE
from pipeline.scenario import Scenario
from pipeline.storage.shards import Size, decode, read_metadata

# Columns that every solved row has a value in
PLANNED = ("states", "controls", "fuel", "fuel_lower_bound", "optimality_gap", "node_collisions")

VIOLATIONS = {
    "thrust": "breaks the thrust limit",
    "separation": "comes too close",
    "passive safety": "comes too close after a loss of thrust",
}

AT_ONCE = 100  # rows that are certified at once, which bounds memory
ANY = Size(rows=100_000, values=10_000_000)  # the most that a shard of any dataset may hold

Rows = Bool[Array, "N"]


def stands_alone(content: bytes) -> bool:
    """Whether bytes are a shard whose rows are sound, whatever dataset they are of."""
    try:
        table = decode(content, ANY)
        return table.num_rows > 0 and _is_sound(table)
    except (InputError, ValueError):  # other columns have no shape either
        return False


def _is_sound(table: pa.Table) -> bool:
    solved = table.schema.equals(pa.schema(SOLVED_FIELDS))
    if not solved and not table.schema.equals(pa.schema(SCENARIO_FIELDS)):
        return False
    sizes = {scenario.n for scenario in scenarios_of(table)}
    if sizes != {*table["n_spacecraft"].to_pylist()} or len(sizes) != 1:
        return False
    requirements = requirements_of(read_metadata(table))
    return not (solved and any(row_faults(table, sizes.pop(), problem_of(table), requirements)))


def row_faults(
    table: pa.Table, n: int, problem: Problem, requirements: Requirements
) -> Iterator[str]:
    """Every row of a solved shard of swarm size n whose claims are wrong, with the reason."""
    names = table["scenario_id"].to_pylist()
    is_solved = pc.equal(table["status"], SOLVED)
    planned = np.array([table[c].is_valid().to_numpy() for c in PLANNED])
    bad = (planned != is_solved.to_numpy()).any(axis=0)
    yield from (f"{names[k]} is not whole" for k in np.flatnonzero(bad))
    solved = table.filter(is_solved)
    if bad.any() or solved.num_rows == 0:
        return
    names = solved["scenario_id"].to_pylist()
    for what, wrong in _checks(solved, n, problem, requirements):
        yield from (f"{names[k]} {what}" for k in np.flatnonzero(wrong))


def _checks(
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
    collisions = node_collisions(states, problem.collision_radius)
    yield "breaks the dynamics", _beyond(dynamics_defect(states, controls, problem))
    yield "misses an end", _beyond(states[:, :, [0, -1]] - ends)
    yield "has another fuel than its controls", ~np.isclose(used, claimed, rtol=1e-9, atol=0)
    yield "needs less fuel than its lower bound", ~(used >= bound * (1 - 1e-9) - none)
    some = bound > none  # without any fuel the gap is a matter of definition
    found = used / np.where(some, bound, 1.0) - 1
    yield "has another gap than its fuel", some & ~np.isclose(found, gap, rtol=0, atol=1e-9)
    yield "has other node collisions than its states", collisions != colliding
    claimed = solved["min_separation"].to_numpy(zero_copy_only=False).astype(float)
    wrong, apart = _judged(states, controls, ends, problem, requirements)
    if n > 1:
        other = ~(np.abs(apart - claimed) <= 2 * TOLERANCE)
        yield "has another least separation than its states", other
    for what, told in VIOLATIONS.items():
        where = " at a node" * (what == "separation" and requirements.at_nodes)
        yield told + where, np.array([what in found for found in wrong])


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
) -> tuple[list[dict[str, str]], Float[Array, "N"]]:
    """What rows do not satisfy, and their least separation, m; of rows that are finite."""
    wrong: list[dict[str, str]] = [{} for _ in states]
    apart = np.full(len(states), np.nan)
    finite = [np.isfinite(part).all(axis=(1, 2, 3)) for part in (states, controls, ends)]
    rows = np.flatnonzero(np.all(finite, axis=0))
    for some in np.array_split(rows, 1 + len(rows) // AT_ONCE) if len(rows) else ():
        scenarios = [Scenario(problem, *ends[k].swapaxes(0, 1)) for k in some]
        flown, burned = np.concatenate(states[some]), np.concatenate(controls[some])
        found = certify(scenarios, flown, burned, [(0.0, "")] * len(some), requirements)
        for scenario, k, certificate in zip(scenarios, some.tolist(), found, strict=True):
            kept, parts = requirements.separation, (states[k], controls[k], certificate)
            wrong[k] = violations(Plan(scenario, "", SOLVED, *parts, separation=kept))
            least = certificate.min_separation
            apart[k] = np.nan if least is None else least
    return wrong, apart
