"""Integrity of every shard and physics of every row of a dataset, and what is done about faults."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import pyarrow as pa

from pipeline.dataset.stages.physics import row_faults
from pipeline.dataset.stages.sample import OURS, draw_scenarios, missing_scenarios
from pipeline.dataset.stages.solve import complete, refuse_versions
from pipeline.dataset.stages.workers import Workers
from pipeline.dataset.storage.folder import Folder, Where, open_folder
from pipeline.dataset.storage.ledger import Ledger
from pipeline.dataset.storage.lock import sole_writer
from pipeline.dataset.storage.manifest import SCENARIOS, TIMINGS, Manifest, read_manifest
from pipeline.dataset.storage.schema import METADATA_KEY, SCENARIO_FIELDS, SOLVED_FIELDS
from pipeline.dataset.storage.shards import decode, digest_of
from pipeline.errors import InputError
from pipeline.expert import Settings
from pipeline.progress import SILENT, Progress

ASIDE = "_foreign/"
"""Where files that do not belong to a dataset are moved, out of the way of its readers."""


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
        name: the file.
        n: swarm size of its rows.
        rows: which of the sample's rows.
        manifest: of the dataset, without digests.
        digest: what the manifest says, or None where it says nothing.
        counted: rows that it counts for; a scenario that is solved counts once.
    """

    name: str
    n: int
    rows: range
    manifest: Manifest
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
    checks = list(_checks(manifest))
    expected = {check.name for check in checks}
    present = folder.names()
    for name in present:
        if name not in expected and not _belongs(name, manifest):
            yield Fault(name, "does not belong to this dataset", foreign=True)
    plain = _plain(manifest)
    timings = [
        Check(name, 0, range(0), plain, None, 0) for name in present if name.startswith(TIMINGS)
    ]
    there = set(present)
    for check in checks:
        if check.name not in there:
            yield Fault(check.name, "is missing")
    checks = [check for check in checks if check.name in there]
    progress.expect(sum(check.counted for check in checks))
    checks += timings
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
    read_manifest(folder)
    with sole_writer(folder):
        faults = list(verify(folder, workers=workers, progress=progress))
        manifest = read_manifest(folder)
        refuse_versions(manifest, str(folder))
        ledger = Ledger(folder, manifest)
        _set_aside(folder, [fault.path for fault in faults if fault.foreign])
        _discard(ledger, {fault.path for fault in faults if not fault.foreign})
        if ledger.manifest.solve:
            complete(ledger, Settings(**ledger.manifest.solve), workers, progress)
        else:
            draw_scenarios(ledger, list(missing_scenarios(ledger)), workers, progress)
    return faults


def _set_aside(folder: Folder, names: list[str]) -> None:
    for name in names:
        folder.publish(ASIDE + name, folder.read(name))
        folder.remove(name)


def _discard(ledger: Ledger, names: set[str]) -> None:
    """Remove damaged files; timings come from solving, so with them goes the solved shard."""
    made = {name.removeprefix(TIMINGS) for name in names}
    for name in names | made:
        if ledger.folder.exists(name):
            ledger.folder.remove(name)
    ledger.disown(made)


def _checks(manifest: Manifest) -> Iterator[Check]:
    plain = _plain(manifest)
    for n, shard, source in manifest.scenario_shards():
        names = (source, source.removeprefix(SCENARIOS)) if manifest.solve else (source,)
        for name in names:
            rows = manifest.samples[n].rows(shard)
            counted = len(rows) if name == names[-1] else 0
            yield Check(name, n, rows, plain, manifest.shards.get(name), counted)


def _plain(manifest: Manifest) -> Manifest:
    """Without digests, which would go to the workers with each file."""
    return replace(manifest, shards={})


def _belongs(name: str, manifest: Manifest) -> bool:
    """Whether a file that holds no rows may be there: lock, manifest, timings, what was moved."""
    if name.startswith(TIMINGS):
        return name.removeprefix(TIMINGS) in manifest.solved_shards()
    return name.startswith("_") and not name.startswith(SCENARIOS) and bool(OURS.fullmatch(name))


def _judged(check: Check, content: bytes) -> list[str]:
    try:
        table = decode(content)
    except InputError as error:
        return [str(error)]
    if check.name.startswith(TIMINGS):
        return []
    if check.digest is None:
        return ["is not in the manifest; the run that made it was cut short"]
    if digest_of(content) != check.digest:
        return ["does not have the digest that the manifest gives it"]
    return list(_faults(table, check))


def _faults(table: pa.Table, check: Check) -> Iterator[str]:
    solved, manifest = not check.name.startswith(SCENARIOS), check.manifest
    one = manifest.samples[check.n]
    fields = pa.schema(SOLVED_FIELDS if solved else SCENARIO_FIELDS)
    if not table.schema.equals(fields, check_metadata=False):
        yield "has other columns than a dataset of this version"
        return
    meta = manifest.solved_metadata(check.n) if solved else manifest.scenario_metadata(check.n)
    if (table.schema.metadata or {}).get(METADATA_KEY) != meta[METADATA_KEY]:
        yield "was made with other settings or versions than the manifest has"
        return
    if table.num_rows != len(check.rows):
        yield f"has {table.num_rows} rows; expected {len(check.rows)}"
    elif table["split"].to_pylist() != [one.drawn_as(row)[0] for row in check.rows]:
        yield "has rows of other splits than they were drawn for"
    if solved:
        at_nodes = manifest.solve.get("separation") == "nodes"
        yield from row_faults(table, check.n, manifest.problem, at_nodes=at_nodes)
