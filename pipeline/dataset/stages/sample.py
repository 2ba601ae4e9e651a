"""Stage one: scenarios drawn into shards."""

import re
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, replace

from pipeline.dataset.stages.worker import check_worker
from pipeline.dataset.stages.workers import Workers
from pipeline.dataset.storage.folder import Folder, Where, open_folder
from pipeline.dataset.storage.ledger import STAMPS, Ledger
from pipeline.dataset.storage.lock import LOCK, WRITER, sole_writer
from pipeline.dataset.storage.manifest import (
    NAME,
    SCENARIOS,
    TIMINGS,
    Manifest,
    Sample,
    read_manifest,
    refuse_change,
)
from pipeline.dataset.storage.schema import scenario_table
from pipeline.dataset.storage.shards import digest_of, encode
from pipeline.errors import InputError
from pipeline.orbit.problem import Problem
from pipeline.progress import SILENT, Progress
from pipeline.provenance import made_with, refuse_other_versions
from pipeline.scenario import draw

DECIDED_BY = ("orbit", "scenario"), ("numpy", "scipy", "pyarrow")
"""Code of ours and packages that the bytes of scenarios depend on."""

OURS = re.compile(
    rf"{NAME}|{STAMPS}|{LOCK}|{WRITER}|_foreign/.*|({SCENARIOS}|{TIMINGS})?n=\d+/part-\d{{5,}}\.parquet"
)
"""Names of files that a dataset may hold."""


@dataclass(frozen=True)
class Draw:
    """A scenario shard to be drawn."""

    name: str
    n: int
    shard: int
    sample: Sample
    problem: Problem
    metadata: dict[bytes, bytes]
    versions: Mapping[str, str]

    @property
    def rows(self) -> range:
        """Its rows, counted over the whole sample."""
        return self.sample.rows(self.shard)


def sample(
    where: Where | Folder,
    samples: Mapping[int, Sample],
    problem: Problem,
    *,
    jobs: int = -1,
    progress: Progress = SILENT,
) -> Manifest:
    """Draw the scenarios of each swarm size into a folder; shards that are there are kept.

    Args:
        where: dataset folder, new or begun with the same settings.
        samples: how to draw, by swarm size.
        problem: the problem of all scenarios.
        jobs: processes.
        progress: told how far it is.

    Raises:
        InputError: for settings that cannot be sampled or differ from those of the folder.
        ProlearnError: where the folder cannot be written to or workers are killed again and again.
    """
    folder, workers = open_folder(where), Workers(jobs)
    for n, one in samples.items():
        draw(one.family, one.seed, n, 0, problem)  # refuses bad settings before anything exists
    _refuse_foreign(folder)
    with sole_writer(folder):
        ledger = Ledger(folder, _begun(folder, samples, problem))
        ledger.commit()
        tasks = list(missing_scenarios(ledger))
        progress.expect(sum(len(task.rows) for task in tasks))
        draw_scenarios(ledger, tasks, workers, progress)
    return ledger.manifest


def missing_scenarios(ledger: Ledger) -> Iterator[Draw]:
    """Scenario shards that are not there or not sound."""
    manifest = ledger.manifest
    for n, shard, name in manifest.scenario_shards():
        if not ledger.is_sound(name):
            one, meta = manifest.samples[n], manifest.scenario_metadata(n)
            yield Draw(name, n, shard, one, manifest.problem, meta, manifest.sampled_with)


def draw_scenarios(ledger: Ledger, tasks: list[Draw], workers: Workers, progress: Progress) -> None:
    """Draw scenario shards; the plans of one that comes out otherwise count no longer."""
    known = ledger.manifest.shards
    results = workers.work(_drawn, tasks, lambda task: b"", progress)
    with ledger.settled(), closing(results):
        for task, content in results:
            if known.get(task.name, "") not in ("", digest_of(content)):
                ledger.disown([task.name.removeprefix(SCENARIOS)])
            ledger.publish(task.name, content)
            progress.done(len(task.rows))


def _refuse_foreign(folder: Folder) -> None:
    if folder.exists(NAME):
        return
    foreign = [name for name in folder.names() if not OURS.fullmatch(name)]
    if foreign:
        raise InputError(
            f"{folder} holds other files ({foreign[0]}) and no dataset; expected a new or an "
            "empty folder."
        )


def _begun(folder: Folder, samples: Mapping[int, Sample], problem: Problem) -> Manifest:
    """The manifest that the folder has or gets, where its settings agree with these."""
    versions = made_with(*DECIDED_BY)
    if not folder.exists(NAME):
        return Manifest(problem, dict(samples), sampled_with=versions)
    manifest = read_manifest(folder)
    refuse_change(str(folder), asdict(manifest.problem), asdict(problem))
    for n, one in samples.items():
        if n in manifest.samples:
            refuse_change(f"{folder} at n={n}", asdict(manifest.samples[n]), asdict(one))
    refuse_other_versions(f"{folder} was sampled", manifest.sampled_with, versions)
    return replace(manifest, samples={**manifest.samples, **samples})


def _drawn(task: Draw, _: bytes) -> bytes:
    check_worker(task.versions, DECIDED_BY)
    one, drawn = task.sample, [task.sample.drawn_as(row) for row in task.rows]
    scenarios = [draw(one.family, one.seed, task.n, k, task.problem, split) for split, k in drawn]
    return encode(scenario_table(scenarios, [split for split, _ in drawn], task.metadata))
