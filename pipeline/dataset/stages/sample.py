"""Stage one: scenarios drawn into shards."""

from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, replace

from pipeline.dataset.format.layout import TOP
from pipeline.dataset.format.manifest import (
    MadeWith,
    Manifest,
    Shard,
    is_begun,
    read_manifest,
    under_way,
)
from pipeline.dataset.format.samples import Sample
from pipeline.dataset.format.schema import scenario_table
from pipeline.dataset.stages.begun import SAMPLED_BY
from pipeline.errors import InputError
from pipeline.jobs.worker import check_worker
from pipeline.jobs.workers import Workers
from pipeline.orbit.problem import Problem
from pipeline.progress import SILENT, Progress
from pipeline.provenance import made_with, refuse_change, refuse_other_versions
from pipeline.scenario import draw
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.ledger import Ledger
from pipeline.storage.shards import digest_of, encode


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
    Manifest(problem, dict(samples), {}, MadeWith({}, {}), {})  # likewise
    _refuse_foreign(folder)
    with under_way(folder, lambda: _begun(folder, samples, problem), progress) as ledger:
        lost = [s for s in ledger.manifest.expected() if not ledger.is_sound(s.scenarios)]
        draw_scenarios(ledger, lost, workers, progress)
    return ledger.manifest


def draw_scenarios(
    ledger: Ledger[Manifest], shards: list[Shard], workers: Workers, progress: Progress
) -> None:
    """Draw scenario shards; the plans of one that comes out otherwise count no longer."""
    progress.expect(sum(len(shard.rows) for shard in shards))
    known = ledger.manifest.shards
    results = workers.work(_drawn, shards, lambda shard: b"", progress)
    with closing(results):
        for shard, content in results:
            if known.get(shard.scenarios, "") not in ("", digest_of(content)):
                ledger.disown([shard.solved])
            ledger.publish(shard.scenarios, content)
            progress.done(len(shard.rows))


def _refuse_foreign(folder: Folder) -> None:
    if is_begun(folder):
        return
    foreign = [name for name in folder.top() if not TOP.fullmatch(name)]
    if foreign:
        raise InputError(
            f"{folder} holds other files ({foreign[0]}) and no dataset; expected a new or an "
            "empty folder."
        )


def _begun(folder: Folder, samples: Mapping[int, Sample], problem: Problem) -> Manifest:
    """The manifest that the folder has or gets, where its settings agree with these."""
    versions = made_with(*SAMPLED_BY)
    if not is_begun(folder):
        return Manifest(problem, dict(samples), {}, MadeWith(versions, {}), {})
    manifest = read_manifest(folder)
    refuse_change(str(folder), asdict(manifest.problem), asdict(problem))
    for n, one in samples.items():
        if n in manifest.samples:
            refuse_change(f"{folder} at n={n}", asdict(manifest.samples[n]), asdict(one))
    refuse_other_versions(f"{folder} was sampled", manifest.made_with.sample, versions)
    return replace(manifest, samples={**manifest.samples, **samples})


def _drawn(shard: Shard, _: bytes) -> bytes:
    about, one = shard.about, shard.sample
    check_worker(about.made_with.sample, SAMPLED_BY)
    drawn = [one.drawn_as(row) for row in shard.rows]
    scenarios = [draw(one.family, one.seed, shard.n, k, about.problem, split) for split, k in drawn]
    splits = [split for split, _ in drawn]
    return encode(scenario_table(scenarios, splits, shard.metadata(shard.scenarios)))
