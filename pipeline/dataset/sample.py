"""Stage one: scenarios drawn into shards."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from pipeline.dataset.manifest import (
    NAME,
    Manifest,
    Sample,
    read_manifest,
    refuse_change,
    with_shards,
    write_manifest,
)
from pipeline.dataset.schema import metadata, scenario_table
from pipeline.dataset.shards import file_digest, for_each_shard, sole_writer, write_shard
from pipeline.errors import InputError
from pipeline.orbit.problem import Problem
from pipeline.scenario import draw

Report = Callable[[int, int], None]
"""Called after each shard with the instances done in it and how many of them failed."""

Job = tuple[Path, str, int, int, Sample, Problem]


def sample(
    folder: Path,
    samples: Mapping[int, Sample],
    problem: Problem,
    *,
    jobs: int = -1,
    report: Report = lambda done, failed: None,
) -> Manifest:
    """Draw the scenarios of each swarm size into a folder; shards that are there are kept.

    Args:
        folder: dataset folder, new or begun with the same settings.
        samples: how to draw, by swarm size.
        problem: the problem of all scenarios.
        jobs: processes.
        report: called after each shard.

    Raises:
        InputError: for settings that cannot be sampled or differ from those of the folder.
    """
    for n, one in samples.items():
        draw(one.family, one.seed, n, 0, problem)  # refuses bad settings before anything exists
    _refuse_foreign(folder)
    with sole_writer(folder):
        manifest = _begun(folder, samples, problem)
        write_manifest(folder, manifest)
        tasks = list(_missing(folder, manifest))
        digests: dict[str, str] = {}
        for path, digest, rows in for_each_shard(_draw_shard, tasks, jobs, "loky"):
            digests[path] = digest
            report(rows, 0)
        manifest = with_shards(manifest, digests)
        write_manifest(folder, manifest)
    return manifest


def to_draw(folder: Path, samples: Mapping[int, Sample], problem: Problem) -> int:
    """Scenarios that are still to be drawn."""
    if not (folder / NAME).exists():
        return sum(one.count for one in samples.values())
    manifest = _begun(folder, samples, problem)
    return sum(len(job[4].indices(job[3])) for job in _missing(folder, manifest))


def _refuse_foreign(folder: Path) -> None:
    if folder.is_dir() and not (folder / NAME).exists() and any(folder.iterdir()):
        raise InputError(
            f"{folder} holds other files and no dataset; expected a new or an empty folder."
        )


def _begun(folder: Path, samples: Mapping[int, Sample], problem: Problem) -> Manifest:
    """The manifest that the folder has or gets, where its settings agree with these."""
    if not (folder / NAME).exists():
        return Manifest(problem, dict(samples))
    manifest = read_manifest(folder)
    refuse_change(str(folder), asdict(manifest.problem), asdict(problem))
    for n, one in samples.items():
        if n in manifest.samples:
            refuse_change(f"{folder} at n={n}", asdict(manifest.samples[n]), asdict(one))
    return replace(manifest, samples={**manifest.samples, **samples})


def _missing(folder: Path, manifest: Manifest) -> Iterator[Job]:
    for n, shard, path in manifest.scenario_shards():
        file = folder / path
        if not (file.exists() and manifest.shards.get(path) == file_digest(file)):
            yield folder, path, n, shard, manifest.samples[n], manifest.problem


def _draw_shard(job: Job) -> tuple[str, str, int]:
    folder, path, n, shard, one, problem = job
    indices = one.indices(shard)
    with threadpool_limits(1):
        scenarios = [draw(one.family, one.seed, n, index, problem) for index in indices]
    meta = metadata(problem, {"seed": one.seed, "family": one.family})
    table = scenario_table(scenarios, [one.split_of(index) for index in indices], meta)
    return path, write_shard(folder / path, table), len(indices)
