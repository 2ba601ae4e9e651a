"""Stage two: the expert's plans for all scenarios of a dataset, shard by shard."""

from collections.abc import Collection, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from pipeline.dataset.format.manifest import Manifest, Shard, read_manifest, under_way
from pipeline.dataset.format.schema import (
    Outcome,
    same_scenarios,
    scenarios_of,
    solved_table,
    timing_table,
)
from pipeline.dataset.format.solving import recorded, requirements_of, settings_of
from pipeline.dataset.stages.begun import SOLVED_BY, refuse_versions
from pipeline.dataset.stages.sample import draw_scenarios
from pipeline.errors import InputError
from pipeline.expert import Settings, solve_many
from pipeline.jobs.worker import check_worker
from pipeline.jobs.workers import Workers
from pipeline.plan import AT_ALL_TIMES, SOLVED, UNSOLVED, Plan, Requirements
from pipeline.progress import SILENT, Progress
from pipeline.provenance import made_with, refuse_change
from pipeline.scenario import Scenario
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.ledger import Ledger
from pipeline.storage.shards import decode, digest_of, encode, has_metadata


@dataclass(frozen=True)
class Solved:
    """A shard that is solved, as bytes, with its timings and how many rows have no plan."""

    content: bytes
    timings: bytes
    failed: int


def solve(
    where: Where | Folder,
    settings: Settings,
    requirements: Requirements = AT_ALL_TIMES,
    *,
    workers: Workers | None = None,
    progress: Progress = SILENT,
) -> Manifest:
    """Solve what is not solved yet; damaged shards are done again.

    Args:
        where: a sampled dataset.
        settings: of the expert.
        requirements: what the plans must satisfy.
        workers: what to solve it with; all cores of this machine by default.
        progress: told how far it is.

    Raises:
        InputError: where the folder holds no dataset, another process writes to it, or it was
            begun with other settings.
        ProlearnError: where the folder cannot be written to or workers are killed again and again.
    """
    folder, workers = open_folder(where), workers or Workers()
    read_manifest(folder)  # before the lock, which would make a folder
    with under_way(folder, lambda: _begun(folder, settings, requirements), progress) as ledger:
        complete(ledger, workers, progress)
    return ledger.manifest


def complete(
    ledger: Ledger[Manifest], workers: Workers, progress: Progress, leave: Collection[str] = ()
) -> None:
    """Draw and, once settings for that are known, solve whatever is missing or damaged.

    Args:
        ledger: of a folder that is held for writing.
        workers: what to work with.
        progress: told how far it is.
        leave: files whose shards are left alone.
    """
    folder, manifest = ledger.folder, ledger.manifest
    shards = [s for s in manifest.expected() if not {s.scenarios, s.solved} & {*leave}]
    lost = [s for s in shards if not ledger.is_sound(s.scenarios)]
    if lost:
        progress.say(f"{len(lost)} scenario shards are missing or damaged; they are drawn again.")
        draw_scenarios(ledger, lost, workers, SILENT)
    if not manifest.solve:
        return
    wanted = [s for s in shards if not _is_done(ledger, s)]
    wanted.reverse()  # the largest swarms take longest: they first
    progress.expect(sum(len(shard.rows) for shard in wanted))
    results = workers.work(_solved, wanted, lambda s: folder.read(s.scenarios), progress)
    with closing(results):
        for shard, solved in results:
            ledger.publish(shard.solved, solved.content, solved.timings)
            progress.done(len(shard.rows), failed=solved.failed)


def _begun(folder: Folder, settings: Settings, requirements: Requirements) -> Manifest:
    """The manifest of the folder with these settings, where it was begun with no others."""
    manifest, now = read_manifest(folder), recorded(settings, requirements)
    if manifest.solve:
        refuse_change(str(folder), manifest.solve, now)
    refuse_versions(folder, manifest)
    versions = made_with(*SOLVED_BY)
    return replace(manifest, solve=now, made_with=replace(manifest.made_with, solve=versions))


def _is_done(ledger: Ledger[Manifest], shard: Shard) -> bool:
    """Whether plans are there and sound; whole ones of a run that was killed are adopted."""
    name, folder = shard.solved, ledger.folder
    if ledger.is_sound(name):
        return True
    if name in ledger.manifest.shards or not folder.exists(name):
        return False
    try:
        content = folder.read(name)
        table = decode(content, shard.most)
        source = decode(folder.read(shard.scenarios), shard.most)
    except (OSError, InputError):
        return False
    if not (has_metadata(table, shard.metadata(name)) and same_scenarios(table, source)):
        return False
    if encode(table) != content:  # what no page's checksum is about has changed
        return False
    return ledger.adopt(name, content, shard.most)


def _solved(shard: Shard, content: bytes) -> Solved:
    settings, requirements = settings_of(shard.about.solve), requirements_of(shard.about.solve)
    check_worker(shard.about.made_with.solve, SOLVED_BY)
    table = decode(content, shard.most)
    outcomes = _outcomes(scenarios_of(table), settings, requirements)
    solved = encode(solved_table(table, outcomes, shard.metadata(shard.solved)))
    return Solved(
        solved,
        encode(timing_table(table, outcomes, digest_of(solved))),
        sum(outcome.status != SOLVED for outcome in outcomes),
    )


def _outcomes(
    scenarios: Sequence[Scenario], settings: Settings, requirements: Requirements
) -> list[Outcome]:
    """What the expert makes of scenarios.

    Where arithmetic fails, as it may on any scenario, that costs one row. Any other error is one
    of ours, which every row might have, and ends the run.
    """
    try:
        plans = solve_many(scenarios, settings=settings, requirements=requirements)
        return [_outcome(plan) for plan in plans]
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        if len(scenarios) == 1:
            return [Outcome(UNSOLVED, message=f"the expert failed: {error!r}")]
        alone = [_outcomes([one], settings, requirements) for one in scenarios]
        return [outcome for (outcome,) in alone]


def _outcome(plan: Plan) -> Outcome:
    if plan.status == SOLVED and not np.isfinite(plan.states).all():
        return Outcome(UNSOLVED, message="the plan has states that are not finite numbers")
    return Outcome(plan.status, plan.message, plan)
