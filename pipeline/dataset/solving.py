"""Stage two of a dataset: the expert's plans for all of its scenarios, shard by shard."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pyarrow as pa

from pipeline.dataset.manifest import (
    OWNED,
    Manifest,
    Shard,
    read_manifest,
    recorded,
    requirements_of,
    settings_of,
)
from pipeline.dataset.sampling import SAMPLED_BY, draw_shard
from pipeline.dataset.schema import same_scenarios, scenarios_of, solved_table, timing_table
from pipeline.expert import Settings, solve_many
from pipeline.parallel.workers import Workers, check_worker
from pipeline.plan import AT_ALL_TIMES, SOLVED, Plan, Requirements
from pipeline.progress import SILENT, Progress
from pipeline.provenance import DecidedBy, made_with, refuse_change, refuse_other_versions
from pipeline.scenario import Scenario
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.ledger import Ledger, NewShard, open_ledger, write_shards
from pipeline.storage.shards import decode, digest_of, encode, has_metadata

# Code of ours and packages that the bytes of plans depend on
SOLVED_BY: DecidedBy = (
    tuple(f"pipeline/{part}" for part in ("orbit", "scenario", "plan", "expert")),
    ("numpy", "scipy", "pyarrow", "clarabel", "highspy"),
)


def refuse_versions(what: object, manifest: Manifest) -> None:
    """Raise InputError, naming the first version that a dataset was not begun with."""
    made = manifest.made_with
    refuse_other_versions(f"{what} was sampled", made.sample, made_with(*SAMPLED_BY))
    if manifest.solve:
        versions = made_with(*SOLVED_BY)
        refuse_other_versions(f"{what} was solved", made.solve, versions)


def solve(
    where: Where | Folder,
    settings: Settings,
    requirements: Requirements = AT_ALL_TIMES,
    *,
    workers: Workers | None = None,
    progress: Progress = SILENT,
) -> Manifest:
    """Solve what is not solved yet of a sampled dataset; damaged shards are done again.

    InputError where there is no dataset, another process writes to it, or it was begun with other
    settings; ProlearnError as in ``sample``.
    """
    folder = open_folder(where)
    read_manifest(folder)  # before the lock, which would make a folder
    begin = partial(_begin, folder, settings, requirements)
    with open_ledger(folder, OWNED, begin, progress) as ledger:
        complete(ledger, workers or Workers(), progress)
    return ledger.manifest


def complete(
    ledger: Ledger[Manifest], workers: Workers, progress: Progress, leave: Collection[str] = ()
) -> None:
    """Draw or solve what is missing or damaged, except for the shards of files in ``leave``."""
    folder, manifest = ledger.folder, ledger.manifest
    shards = [s for s in manifest.expected() if not {s.scenarios, s.solved} & {*leave}]
    lost = [s for s in shards if not ledger.is_sound(s.scenarios)]
    if lost:
        progress.say(f"{len(lost)} scenario shards are missing or damaged; they are drawn again.")
        write_shards(ledger, draw_shard, lost, workers, SILENT)
    if manifest.solve:
        wanted = [s for s in shards if not _is_done(ledger, s)]
        wanted.reverse()  # the largest swarms take longest: they first
        load = lambda shard: folder.read(shard.scenarios)  # noqa: E731
        write_shards(ledger, _solved, wanted, workers, progress, load)


def _begin(folder: Folder, settings: Settings, requirements: Requirements) -> Manifest:
    """The manifest with these settings, where the folder was begun with no others."""
    manifest, now = read_manifest(folder), recorded(settings, requirements)
    if manifest.solve:
        refuse_change(str(folder), manifest.solve, now)
    refuse_versions(folder, manifest)
    versions = made_with(*SOLVED_BY)
    return replace(manifest, solve=now, made_with=replace(manifest.made_with, solve=versions))


def _is_done(ledger: Ledger[Manifest], shard: Shard) -> bool:
    """Whether plans are there and sound; whole ones of a run that was killed are adopted."""
    name, folder = shard.solved, ledger.folder

    def fits(table: pa.Table) -> bool:
        if not has_metadata(table, shard.metadata(name)):
            return False
        return same_scenarios(table, decode(folder.read(shard.scenarios), shard.most))

    if name in ledger.shards or not folder.exists(name):
        return ledger.is_sound(name)
    return ledger.adopt(name, shard.most, fits)


def _solved(shard: Shard, content: bytes) -> NewShard:
    settings, requirements = settings_of(shard.about.solve), requirements_of(shard.about.solve)
    check_worker(shard.about.made_with.solve, SOLVED_BY)
    table = decode(content, shard.most)
    plans = _plans(scenarios_of(table), settings, requirements)
    solved = encode(solved_table(table, plans, shard.metadata(shard.solved)))
    timings = encode(timing_table(table, plans, digest_of(solved)))
    failed = sum(isinstance(plan, str) or plan.status != SOLVED for plan in plans)
    return NewShard(shard.solved, solved, timings, failed=failed)


def _plans(
    scenarios: Sequence[Scenario], settings: Settings, requirements: Requirements
) -> list[Plan | str]:
    """Plans, or why there is none: failing arithmetic costs a row, other errors end the run."""
    try:
        plans = solve_many(scenarios, settings=settings, requirements=requirements)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        if len(scenarios) == 1:
            return [f"the expert failed: {error!r}"]
        return [plan for one in scenarios for plan in _plans([one], settings, requirements)]
    overflowed = [p.status == SOLVED and not np.isfinite(p.states).all() for p in plans]
    why = "the plan has states that are not finite numbers"
    return [why if over else plan for plan, over in zip(plans, overflowed, strict=True)]
