"""Stage one of a dataset: scenarios are drawn into shards, whose bytes the manifest decides."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial

from pipeline.dataset.manifest import OWNED, TOP, MadeWith, Manifest, Shard, is_begun, read_manifest
from pipeline.dataset.samples import Sample
from pipeline.dataset.schema import scenario_table
from pipeline.errors import InputError
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers, check_worker
from pipeline.progress import SILENT, Progress
from pipeline.provenance import DecidedBy, made_with, refuse_change, refuse_other_versions
from pipeline.scenario import draw, draw_many
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.ledger import NewShard, open_ledger, write_shards
from pipeline.storage.shards import encode

# Code of ours and packages that the bytes of scenarios depend on
SAMPLED_BY: DecidedBy = ("pipeline/orbit", "pipeline/scenario"), ("numpy", "scipy", "pyarrow")


def sample(
    where: Where | Folder,
    samples: Mapping[int, Sample],
    problem: Problem,
    *,
    workers: Workers | None = None,
    progress: Progress = SILENT,
) -> Manifest:
    """Draw samples, by swarm size, into a new folder or one begun with the same settings.

    Shards that are there are kept. InputError for settings that cannot be sampled or differ from
    those of the folder; ProlearnError where it cannot be written to or workers are killed again and
    again.
    """
    folder, workers = open_folder(where), workers or Workers()
    for n, one in samples.items():
        draw(one.family, one.seed, n, 0, problem)  # refuses bad settings before anything exists
    Manifest(problem, dict(samples), {}, MadeWith({}, {}), {})  # likewise
    foreign = [] if is_begun(folder) else [one for one in folder.top() if not TOP.fullmatch(one)]
    if foreign:
        raise InputError(
            f"{folder} holds other files ({foreign[0]}) and no dataset; expected a new or an "
            "empty folder."
        )
    begin = partial(_begin, folder, samples, problem)
    with open_ledger(folder, OWNED, begin, progress) as ledger:
        lost = [s for s in ledger.manifest.expected() if not ledger.is_sound(s.scenarios)]
        write_shards(ledger, draw_shard, lost, workers, progress)
    return ledger.manifest


def _begin(folder: Folder, samples: Mapping[int, Sample], problem: Problem) -> Manifest:
    """The manifest that the folder has or gets, where its settings agree with these."""
    versions = made_with(*SAMPLED_BY)
    if not is_begun(folder):
        return Manifest(problem, dict(samples), {}, MadeWith(versions, {}), {})
    manifest = read_manifest(folder)
    refuse_change(str(folder), manifest.problem.document(), problem.document())
    for n, one in samples.items():
        if n in manifest.samples:
            refuse_change(f"{folder} at n={n}", asdict(manifest.samples[n]), asdict(one))
    refuse_other_versions(f"{folder} was sampled", manifest.made_with.sample, versions)
    return replace(manifest, samples={**manifest.samples, **samples})


def draw_shard(shard: Shard, _: bytes) -> NewShard:
    """In a worker: the scenarios of a shard; its plans are dropped where these have changed."""
    about, one = shard.about, shard.sample
    check_worker(about.made_with.sample, SAMPLED_BY)
    drawn = one.drawn_as(shard.rows)
    scenarios = draw_many(one.family, one.seed, shard.n, drawn, about.problem)
    splits = [split for split, _ in drawn]
    content = encode(scenario_table(scenarios, splits, shard.metadata(shard.scenarios)))
    return NewShard(shard.scenarios, content, derived=shard.solved)
