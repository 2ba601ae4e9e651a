"""Stage two: the expert's plans for all scenarios of a dataset, shard by shard."""

from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, replace

import numpy as np

from pipeline.dataset.stages.sample import DECIDED_BY as SAMPLED_BY
from pipeline.dataset.stages.sample import draw_scenarios, missing_scenarios
from pipeline.dataset.stages.worker import check_worker
from pipeline.dataset.stages.workers import Workers
from pipeline.dataset.storage.folder import Folder, Where, open_folder
from pipeline.dataset.storage.ledger import Ledger
from pipeline.dataset.storage.lock import sole_writer
from pipeline.dataset.storage.manifest import (
    SCENARIOS,
    TIMINGS,
    Manifest,
    read_manifest,
    refuse_change,
)
from pipeline.dataset.storage.schema import (
    METADATA_KEY,
    Outcome,
    same_scenarios,
    scenarios_of,
    solved_table,
    timing_table,
)
from pipeline.dataset.storage.shards import decode, digest_of, encode
from pipeline.errors import InputError
from pipeline.expert import Settings
from pipeline.expert import solve as solve_scenario
from pipeline.plan import SOLVED, UNSOLVED
from pipeline.progress import SILENT, Progress
from pipeline.provenance import DecidedBy, made_with, refuse_other_versions
from pipeline.scenario import Scenario


@dataclass(frozen=True)
class Solve:
    """A shard to be solved."""

    name: str
    rows: int
    metadata: dict[bytes, bytes]
    settings: Settings
    versions: Mapping[str, str]


@dataclass(frozen=True)
class Solved:
    """A shard that is solved, as bytes, with its timings and how many rows have no plan."""

    content: bytes
    timings: bytes
    failed: int


def solve(
    where: Where | Folder,
    settings: Settings,
    *,
    workers: Workers | None = None,
    progress: Progress = SILENT,
) -> Manifest:
    """Solve what is not solved yet; damaged shards are done again.

    Args:
        where: a sampled dataset.
        settings: of the expert.
        workers: what to solve it with; all cores of this machine by default.
        progress: told how far it is.

    Raises:
        InputError: where the folder holds no dataset, another process writes to it, or it was
            begun with other settings.
        ProlearnError: where the folder cannot be written to or workers are killed again and again.
    """
    folder, workers = open_folder(where), workers or Workers()
    _begun(read_manifest(folder), str(folder), settings)  # refused before anything is written
    with sole_writer(folder):
        ledger = Ledger(folder, _begun(read_manifest(folder), str(folder), settings))
        ledger.commit()
        complete(ledger, settings, workers, progress)
    return ledger.manifest


def complete(ledger: Ledger, settings: Settings, workers: Workers, progress: Progress) -> None:
    """Draw and solve whatever is missing or damaged in a folder that is held for writing."""
    lost = list(missing_scenarios(ledger))
    if lost:
        progress.say(f"{len(lost)} scenario shards are missing or damaged; they are drawn again.")
        draw_scenarios(ledger, lost, workers, SILENT)
    tasks = list(_missing(ledger, settings))[::-1]  # the largest swarms take longest: they first
    progress.expect(sum(task.rows for task in tasks))

    def load(task: Solve) -> bytes:
        return ledger.folder.read(SCENARIOS + task.name)

    with ledger.settled(), closing(workers.work(_solved, tasks, load, progress)) as results:
        for task, solved in results:
            ledger.folder.publish(TIMINGS + task.name, solved.timings)
            ledger.publish(task.name, solved.content)
            progress.done(task.rows, failed=solved.failed)


def _begun(manifest: Manifest, folder: str, settings: Settings) -> Manifest:
    now, versions = asdict(settings), made_with(*decided_by(settings))
    if manifest.solve:
        refuse_change(folder, manifest.solve, now)
    refuse_versions(manifest, folder)
    return replace(manifest, solve=now, solved_with=versions)


def refuse_versions(manifest: Manifest, folder: str) -> None:
    """Refuse to go on with a dataset that other versions have begun.

    Raises:
        InputError: naming the first version that differs.
    """
    refuse_other_versions(f"{folder} was sampled", manifest.sampled_with, made_with(*SAMPLED_BY))
    if manifest.solve:
        versions = made_with(*decided_by(Settings(**manifest.solve)))
        refuse_other_versions(f"{folder} was solved", manifest.solved_with, versions)


def decided_by(settings: Settings) -> DecidedBy:
    """Code of ours and packages that the bytes of plans depend on."""
    readable = ("cvxpy",) if settings.solver == "cvxpy" else ()
    packages = ("numpy", "scipy", "pyarrow", "clarabel", *readable)
    return ("orbit", "scenario", "plan", "expert"), packages


def _missing(ledger: Ledger, settings: Settings) -> Iterator[Solve]:
    """Shards that are not there or not sound; whole ones of a run that was killed are adopted."""
    manifest = ledger.manifest
    for n, shard, source in manifest.scenario_shards():
        one = manifest.samples[n]
        name, meta = source.removeprefix(SCENARIOS), manifest.solved_metadata(n)
        task = Solve(name, len(one.rows(shard)), meta, settings, manifest.solved_with)
        if not (ledger.is_sound(name) or _adopted(ledger, task)):
            yield task


def _adopted(ledger: Ledger, task: Solve) -> bool:
    """Whether a shard that the manifest does not know yet is what this run would make."""
    if task.name in ledger.manifest.shards or not ledger.folder.exists(task.name):
        return False
    try:
        content = ledger.folder.read(task.name)
        table, source = decode(content), decode(ledger.folder.read(SCENARIOS + task.name))
    except (OSError, InputError):
        return False
    found = (table.schema.metadata or {}).get(METADATA_KEY)
    if found != task.metadata[METADATA_KEY] or not same_scenarios(table, source):
        return False
    ledger.adopt(task.name, digest_of(content))
    return True


def _solved(task: Solve, content: bytes) -> Solved:
    check_worker(task.versions, decided_by(task.settings))
    table = decode(content)
    outcomes = [_outcome(scenario, task.settings) for scenario in scenarios_of(table)]
    return Solved(
        encode(solved_table(table, outcomes, task.metadata)),
        encode(timing_table(table, outcomes)),
        sum(outcome.status != SOLVED for outcome in outcomes),
    )


def _outcome(scenario: Scenario, settings: Settings) -> Outcome:
    """What the expert makes of a scenario.

    Where arithmetic fails, as it may on any scenario, that costs one row. Any other error is one
    of ours, which every row might have, and ends the run.
    """
    try:
        plan = solve_scenario(scenario, settings=settings)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        return Outcome(UNSOLVED, message=f"the expert failed: {error!r}")
    if plan.status == SOLVED and not np.isfinite(plan.states).all():
        return Outcome(UNSOLVED, message="the plan has states that are not finite numbers")
    return Outcome(plan.status, plan.message, plan)
