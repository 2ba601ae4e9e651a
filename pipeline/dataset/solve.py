"""Stage two: the expert's plans for all scenarios of a dataset, shard by shard."""

import json
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from pipeline.dataset.manifest import (
    Manifest,
    read_manifest,
    refuse_change,
    with_shards,
    write_manifest,
)
from pipeline.dataset.sample import Report
from pipeline.dataset.schema import (
    METADATA_KEY,
    metadata,
    problem_of,
    scenarios_of,
    solved_table,
    timing_table,
)
from pipeline.dataset.shards import (
    file_digest,
    for_each_shard,
    read_shard,
    sole_writer,
    write_shard,
)
from pipeline.expert import Settings
from pipeline.expert import solve as solve_scenario
from pipeline.plan import SOLVED

Job = tuple[Path, str, str, Settings]


def solve(
    folder: Path,
    settings: Settings,
    *,
    jobs: int = -1,
    backend: str = "loky",
    report: Report = lambda done, failed: None,
) -> Manifest:
    """Solve what is not solved yet; each worker publishes its shard whole.

    Args:
        folder: a sampled dataset.
        settings: of the expert.
        jobs: processes.
        backend: joblib backend, "loky" or "dask".
        report: called after each shard.

    Raises:
        InputError: where the folder holds no dataset, another process writes to it, or it was
            begun with other settings.
        ProlearnError: where a worker was killed.
    """
    manifest = _begun(folder, settings)
    with sole_writer(folder):
        write_manifest(folder, manifest)
        tasks = [job for job, _ in _missing(folder, manifest, settings)]
        digests: dict[str, str] = {}
        for path, digest, rows, failed in for_each_shard(_solve_shard, tasks, jobs, backend):
            digests[path] = digest
            report(rows, failed)
        present = {p: file_digest(folder / p) for p in manifest.solved_shards()}
        manifest = with_shards(manifest, present | digests)
        write_manifest(folder, manifest)
    return manifest


def to_solve(folder: Path, settings: Settings) -> int:
    """Instances that are still to be solved."""
    missing = _missing(folder, _begun(folder, settings), settings)
    return sum(rows for _, rows in missing)


def _begun(folder: Path, settings: Settings) -> Manifest:
    manifest, now = read_manifest(folder), asdict(settings)
    if manifest.solve:
        refuse_change(str(folder), manifest.solve, now)
    return replace(manifest, solve=now)


def _missing(folder: Path, manifest: Manifest, settings: Settings) -> Iterator[tuple[Job, int]]:
    """Shards that are absent, or not what the manifest or their own metadata says."""
    for n, shard, source in manifest.scenario_shards():
        path = source.removeprefix("_scenarios/")
        file = folder / path
        known = manifest.shards.get(path)
        if not (file.exists() and known in (None, file_digest(file))):
            yield (folder, source, path, settings), len(manifest.samples[n].indices(shard))


def _solve_shard(job: Job) -> tuple[str, str, int, int]:
    folder, source, path, settings = job
    table = read_shard(folder / source)
    with threadpool_limits(1):
        plans = [solve_scenario(s, settings=settings) for s in scenarios_of(table)]
    sampled = json.loads(table.schema.metadata[METADATA_KEY])
    origin = {name: sampled[name] for name in ("seed", "family")}
    meta = metadata(problem_of(table.schema), origin | asdict(settings))
    write_shard(folder / "_timings" / path, timing_table(table, plans))
    digest = write_shard(folder / path, solved_table(table, plans, meta))
    failed = sum(plan.status != SOLVED for plan in plans)
    return path, digest, len(plans), failed
