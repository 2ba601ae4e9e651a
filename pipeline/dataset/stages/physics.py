"""What physics says against the rows of a solved shard: all is computed anew from the arrays."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Bool, Float

from pipeline.arrays import Array
from pipeline.dataset.format.schema import stacked
from pipeline.orbit.approaches import TOLERANCE, side_by_side
from pipeline.orbit.passive_safety import least_after_loss
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import least_separation, node_collisions
from pipeline.orbit.transfer import dynamics_defect, fuel
from pipeline.plan import SOLVED, Requirements
from pipeline.plan.judge import POSITION_TOLERANCE, VELOCITY_TOLERANCE

PLANNED = ("states", "controls", "fuel", "fuel_lower_bound", "optimality_gap", "node_collisions")
"""Columns that every solved row has a value in."""

Rows = Bool[Array, "N"]


def row_faults(
    table: pa.Table, n: int, problem: Problem, requirements: Requirements
) -> Iterator[str]:
    """Every row of a solved shard that does not hold what it claims, with the reason.

    Args:
        table: rows of one swarm size.
        n: that size.
        problem: what they are meant to solve.
        requirements: what its plans satisfy.
    """
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
        ends = stacked(solved, "initial", n, 6), stacked(solved, "goal", n, 6)
    except ValueError:
        yield "has arrays of another shape", np.arange(solved.num_rows) == 0
        return
    column: Callable[[str], Any] = lambda name: solved[name].to_numpy()  # noqa: E731
    used, bound, none = fuel(controls), column("fuel_lower_bound"), problem.negligible_fuel
    collisions = node_collisions(states, problem.collision_radius)
    yield "breaks the dynamics", _beyond(dynamics_defect(states, controls, problem))
    yield (
        "misses an end",
        _beyond(states[..., 0, :] - ends[0]) | _beyond(states[..., -1, :] - ends[1]),
    )
    yield "has another fuel than its controls", ~np.isclose(used, column("fuel"), rtol=1e-9, atol=0)
    yield "needs less fuel than its lower bound", ~(used >= bound * (1 - 1e-9) - none)
    yield "has another gap than its fuel", _wrong_gap(used, bound, column("optimality_gap"), none)
    yield "has other node collisions than its states", collisions != column("node_collisions")
    if problem.max_acceleration is not None:
        within = np.abs(controls).max(axis=(1, 2, 3)) <= problem.most_control
        yield "breaks the thrust limit", ~within
    if requirements.at_nodes:
        yield "comes too close at a node", collisions > 0
    if n > 1:
        claimed = solved["min_separation"].to_numpy(zero_copy_only=False).astype(float)
        close, other = _separation(states, controls, problem, claimed)
        yield "has another least separation than its states", other
        if not requirements.at_nodes:
            yield "comes too close", close
        orbits = requirements.passive_safety
        if orbits is not None:
            adrift = _close_adrift(states, controls, problem, orbits)
            yield "comes too close after a loss of thrust", adrift


def _beyond(error: Float[Array, "N *rest 6"]) -> Rows:
    worst = np.abs(error).max(axis=tuple(range(1, error.ndim - 1)))
    far = worst[:, :3].max(axis=1) > POSITION_TOLERANCE
    return ~np.isfinite(worst).all(axis=1) | far | (worst[:, 3:].max(axis=1) > VELOCITY_TOLERANCE)


def _wrong_gap(
    used: Float[Array, "N"], bound: Float[Array, "N"], claimed: Float[Array, "N"], none: float
) -> Rows:
    """Where there is fuel to speak of; without any the gap is a matter of definition."""
    some = bound > none
    gap = used / np.where(some, bound, 1.0) - 1
    return some & ~np.isclose(gap, claimed, rtol=0, atol=1e-9)


def _separation(
    states: Float[Array, "N n T 6"],
    controls: Float[Array, "N n intervals 3"],
    problem: Problem,
    claimed: Float[Array, "N"],
) -> tuple[Rows, Rows]:
    """Rows that come within r_col, and rows whose least separation is not the claimed one."""
    bound, distance = np.full((2, len(states)), -np.inf)
    finite = np.isfinite(states).all(axis=(1, 2, 3)) & np.isfinite(controls).all(axis=(1, 2, 3))
    for k in np.flatnonzero(finite):
        found = least_separation(states[k], controls[k], problem)
        bound[k], distance[k] = found.bound, found.distance
    return bound <= problem.collision_radius, ~(np.abs(distance - claimed) <= 2 * TOLERANCE)


def _close_adrift(
    states: Float[Array, "N n T 6"],
    controls: Float[Array, "N n intervals 3"],
    problem: Problem,
    orbits: float,
) -> Rows:
    """Rows in which a craft that has lost its thrust comes within r_col of another."""
    swarm = side_by_side((states.shape[1],))
    rows = zip(states, controls, strict=True)
    found = [least_after_loss(*row, problem, orbits, swarm)[0] for row in rows]
    return np.array([one.bound <= problem.collision_radius for one in found])
