"""Integrity of every shard and physics of every row of a dataset, and what is done about faults."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import pyarrow as pa

from pipeline.dataset.format.layout import BOOKS
from pipeline.dataset.format.manifest import Manifest, Shard, read_manifest, under_way
from pipeline.dataset.format.schema import SCENARIO_FIELDS, SOLVED_FIELDS, has_metadata
from pipeline.dataset.stages.begun import refuse_versions
from pipeline.dataset.stages.physics import row_faults
from pipeline.dataset.stages.sample import draw_scenarios, lost_scenarios
from pipeline.dataset.stages.solve import complete
from pipeline.errors import InputError
from pipeline.jobs.workers import Workers
from pipeline.progress import SILENT, Progress
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.layout import FOREIGN, TIMINGS
from pipeline.storage.ledger import Ledger
from pipeline.storage.shards import decode, digest_of


@dataclass(frozen=True)
class Fault:
    """Something wrong in a dataset.

    Attributes:
        path: the file, inside the folder.
        what: what is wrong with it.
        foreign: whether it does not belong there at all.
    """

    path: str
    what: str
    foreign: bool = False


@dataclass(frozen=True)
class Check:
    """A file to be judged, with what it is meant to be.

    Attributes:
        name: the file: scenarios, solved instances or timings of the shard.
        shard: what it is meant to hold.
        digest: what the manifest says, or None where it says nothing.
        counted: rows that it counts for; a scenario that is solved counts once.
    """

    name: str
    shard: Shard
    digest: str | None
    counted: int


def verify(
    where: Where | Folder, *, workers: Workers | None = None, progress: Progress = SILENT
) -> Iterator[Fault]:
    """Every fault of a dataset, as it is found.

    Args:
        where: a dataset; one that is sampled and not yet solved is judged as such.
        workers: what to verify it with; all cores of this machine by default.
        progress: told how far it is.

    Raises:
        InputError: where the folder holds no dataset.
    """
    folder, workers = open_folder(where), workers or Workers()
    manifest = read_manifest(folder)
    present = set(folder.names())
    checks = list(_checks(manifest, present))
    expected = {check.name for check in checks}
    for name in sorted(present - expected):
        if not BOOKS.fullmatch(name):
            yield Fault(name, "does not belong to this dataset", foreign=True)
    for check in checks:
        if check.name not in present:
            yield Fault(check.name, "is missing")
    checks = [check for check in checks if check.name in present]
    progress.expect(sum(check.counted for check in checks))
    for check, found in workers.work(_judged, checks, lambda c: folder.read(c.name), progress):
        yield from (Fault(check.name, what) for what in found)
        progress.done(check.counted)


def repair(
    where: Where | Folder, *, workers: Workers | None = None, progress: Progress = SILENT
) -> list[Fault]:
    """Do again exactly the shards that have faults, and move foreign files to ``_foreign/``.

    Returns:
        The faults that were found.

    Raises:
        InputError: where the folder holds no dataset or another process writes to it.
        ProlearnError: where the folder cannot be written to or workers are killed again and again.
    """
    folder, workers = open_folder(where), workers or Workers()
    read_manifest(folder)  # before the lock, which would make a folder
    with under_way(folder, lambda: _begun(folder)) as ledger:
        faults = list(verify(folder, workers=workers, progress=progress))
        for fault in faults:
            if fault.foreign:
                folder.publish(FOREIGN + fault.path, folder.read(fault.path))
                folder.remove(fault.path)
        _discard(ledger, {fault.path for fault in faults if not fault.foreign})
        if ledger.manifest.solve:
            complete(ledger, workers, progress)
        else:
            draw_scenarios(ledger, lost_scenarios(ledger), workers, progress)
    return faults


def _begun(folder: Folder) -> Manifest:
    manifest = read_manifest(folder)
    refuse_versions(folder, manifest)
    return manifest


def _discard(ledger: Ledger[Manifest], names: set[str]) -> None:
    """Remove damaged files; timings come from solving, so with them goes the solved shard."""
    made = {name.removeprefix(TIMINGS) for name in names}
    for name in names | made:
        if ledger.folder.exists(name):
            ledger.folder.remove(name)
    ledger.disown(made)


def _checks(manifest: Manifest, present: Collection[str]) -> Iterator[Check]:
    """Every file that is meant to be there, and timings where there are any."""
    for shard in manifest.expected():
        held = (shard.scenarios, shard.solved) if manifest.solve else (shard.scenarios,)
        for name in (*held, shard.timings):
            if name in held or name in present:
                counted = len(shard.rows) if name == held[-1] else 0
                yield Check(name, shard, manifest.shards.get(name), counted)


def _judged(check: Check, content: bytes) -> list[str]:
    try:
        table = decode(content)
    except InputError as error:
        return [str(error)]
    if check.name == check.shard.timings:
        return []
    if check.digest is None:
        return ["is not in the manifest; the run that made it was cut short"]
    if digest_of(content) != check.digest:
        return ["does not have the digest that the manifest gives it"]
    return list(_faults(table, check.shard, check.name))


def _faults(table: pa.Table, shard: Shard, name: str) -> Iterator[str]:
    solved, one = name == shard.solved, shard.sample
    fields = pa.schema(SOLVED_FIELDS if solved else SCENARIO_FIELDS)
    if not table.schema.equals(fields, check_metadata=False):
        yield "has other columns than a dataset of this version"
        return
    if not has_metadata(table, shard.metadata(name)):
        yield "was made with other settings or versions than the manifest has"
        return
    if table.num_rows != len(shard.rows):
        yield f"has {table.num_rows} rows; expected {len(shard.rows)}"
    elif table["split"].to_pylist() != [one.drawn_as(row)[0] for row in shard.rows]:
        yield "has rows of other splits than they were drawn for"
    if solved:
        at_nodes = shard.about.solve.get("separation") == "nodes"
        yield from row_faults(table, shard.n, shard.about.problem, at_nodes=at_nodes)
