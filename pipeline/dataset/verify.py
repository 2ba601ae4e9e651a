"""Integrity of every shard and physics of every row of a dataset."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Bool, Float

from pipeline.arrays import Array
from pipeline.dataset.manifest import Manifest, read_manifest
from pipeline.dataset.schema import METADATA_KEY, problem_of, stacked
from pipeline.dataset.shards import file_digest, read_shard
from pipeline.errors import InputError
from pipeline.orbit.cw import cw_matrices
from pipeline.orbit.fuel import fuel
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import least_separation, node_collisions
from pipeline.plan import SOLVED

POSITION_TOLERANCE = 1e-6
"""Largest miss of an end or of Eq. 2, m."""

VELOCITY_TOLERANCE = 1e-9
"""Largest miss of an end or of Eq. 2, m/s."""


@dataclass(frozen=True)
class Fault:
    """Something wrong in a dataset.

    Attributes:
        path: the shard, inside the folder.
        what: what is wrong with it.
    """

    path: str
    what: str


def verify(folder: Path, report: Callable[[int], None] = lambda rows: None) -> Iterator[Fault]:
    """Every fault of a solved dataset, as it is found.

    Raises:
        InputError: where the folder holds no dataset.
    """
    manifest = read_manifest(folder)
    expected = [path for _, _, path in manifest.scenario_shards()]
    expected += manifest.solved_shards()
    for path in expected:
        yield from _shard_faults(folder, path, manifest, report)
    present = (p.relative_to(folder).as_posix() for p in sorted(folder.rglob("*.parquet")))
    for path in present:
        if path not in expected and not path.startswith("_timings/"):
            yield Fault(path, "does not belong to this dataset")


def _shard_faults(
    folder: Path, path: str, manifest: Manifest, report: Callable[[int], None]
) -> Iterator[Fault]:
    file = folder / path
    if not file.exists():
        yield Fault(path, "is missing")
        return
    if manifest.shards.get(path) != file_digest(file):
        yield Fault(path, "does not have the digest that the manifest gives it")
    try:
        table = read_shard(file)
    except InputError as error:
        yield Fault(path, str(error))
        return
    if not path.startswith("_"):
        yield from (Fault(path, what) for what in _row_faults(table, manifest))
        report(table.num_rows)


def _row_faults(table: pa.Table, manifest: Manifest) -> Iterator[str]:
    """What the physics of a shard's solved rows says against them."""
    if METADATA_KEY not in (table.schema.metadata or {}):
        yield "has no metadata"
        return
    problem = problem_of(table.schema)
    if problem != manifest.problem:
        yield "was made for another problem"
    solved = table.filter(pc.equal(table["status"], SOLVED))
    if solved.num_rows == 0:
        return
    n = solved["n_spacecraft"][0].as_py()
    states = stacked(solved, "states", n, problem.nodes, 6)
    controls = stacked(solved, "controls", n, problem.intervals, 3)
    ends = stacked(solved, "initial", n, 6), stacked(solved, "goal", n, 6)
    at_nodes = manifest.solve.get("separation") == "nodes"
    checks = {
        "breaks the dynamics": _breaks_dynamics(states, controls, problem),
        "misses an end": _misses_end(states, *ends),
        "has another fuel than its controls": ~np.isclose(
            fuel(controls), solved["fuel"].to_numpy(), rtol=1e-9, atol=0
        ),
        "has other node collisions than its states": (
            node_collisions(states, problem.collision_radius)
            != solved["node_collisions"].to_numpy()
        ),
        "comes too close": _too_close(states, controls, problem, at_nodes=at_nodes),
    }
    names = solved["scenario_id"].to_pylist()
    for what, bad in checks.items():
        yield from (f"{names[k]} {what}" for k in np.flatnonzero(bad))


def _breaks_dynamics(
    states: Float[Array, "N n T 6"], controls: Float[Array, "N n intervals 3"], problem: Problem
) -> Bool[Array, "N"]:
    A, B = cw_matrices(problem.mean_motion, problem.time_step)
    return _beyond(states[..., 1:, :] - states[..., :-1, :] @ A.T - controls @ B.T)


def _misses_end(
    states: Float[Array, "N n T 6"], initial: Float[Array, "N n 6"], goal: Float[Array, "N n 6"]
) -> Bool[Array, "N"]:
    return _beyond(states[..., 0, :] - initial) | _beyond(states[..., -1, :] - goal)


def _beyond(error: Float[Array, "N *rest 6"]) -> Bool[Array, "N"]:
    worst = np.abs(error).max(axis=tuple(range(1, error.ndim - 1)))
    far = worst[:, :3].max(axis=1) > POSITION_TOLERANCE
    return ~np.isfinite(worst).all(axis=1) | far | (worst[:, 3:].max(axis=1) > VELOCITY_TOLERANCE)


def _too_close(
    states: Float[Array, "N n T 6"],
    controls: Float[Array, "N n intervals 3"],
    problem: Problem,
    *,
    at_nodes: bool,
) -> Bool[Array, "N"]:
    if at_nodes:
        return node_collisions(states, problem.collision_radius) > 0
    bounds = (least_separation(s, u, problem).bound for s, u in zip(states, controls, strict=True))
    return np.fromiter(bounds, float) <= problem.collision_radius
