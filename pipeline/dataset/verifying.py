"""Integrity of every shard and physics of every row of a dataset, and the repair of faults."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import pyarrow as pa

from pipeline.dataset.manifest import (
    BESIDE,
    OWNED,
    SHARD,
    Manifest,
    Shard,
    manifest_or_copy,
    requirements_of,
)
from pipeline.dataset.physics import row_faults, stands_alone
from pipeline.dataset.schema import SCENARIO_FIELDS, SOLVED_FIELDS, TIMING_FIELDS
from pipeline.dataset.solving import complete, refuse_versions
from pipeline.documents import CHECKSUM, parsed
from pipeline.errors import InputError
from pipeline.parallel.workers import Workers
from pipeline.progress import SILENT, Progress
from pipeline.storage import COPY, FOREIGN, MANIFEST, TIMED, TIMINGS
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.ledger import Ledger, committed, read_timed, set_aside, sole_writer
from pipeline.storage.shards import TIMED_KEY, decode, digest_of, has_metadata

DIGEST = "does not have the digest that the manifest gives it"
CUT_SHORT = "is not in the manifest; the run that made it was cut short"
UNTIMED = f"is not in {TIMED}"
NOT_EXPECTED = "does not belong to this dataset"
FIELDS = {"scenarios": SCENARIO_FIELDS, "solved": SOLVED_FIELDS, "timings": TIMING_FIELDS}
MOST_BYTES = 2**30  # size of the largest file that is read to be checked; shards have some MB


@dataclass(frozen=True)
class Fault:
    """A fault of a dataset."""

    path: str  # the file, inside the folder
    what: str  # what is wrong with it
    foreign: bool = False  # whether it does not belong there at all
    sound: bool = False  # whether it holds sound rows all the same, which are not given up unasked


@dataclass(frozen=True)
class Check:
    """A file to be checked."""

    name: str  # the file
    kind: Literal["scenarios", "solved", "timings", "foreign"]  # of its content
    shard: Shard | None = None  # that it is meant to hold, or None where it is foreign
    digest: str | None = None  # that the manifest gives it, or None
    solved: str | None = None  # of timings, the digest of the solved instances
    counted: int = 0  # rows that it counts for; a scenario that is solved counts once


def verify(
    where: Where | Folder, *, workers: Workers | None = None, progress: Progress = SILENT
) -> Iterator[Fault]:
    """Every fault of a dataset, solved or not, as it is found; InputError without a manifest."""
    folder, workers = open_folder(where), workers or Workers()
    manifest, fault = manifest_or_copy(folder)
    if fault:
        yield Fault(MANIFEST, fault)
    checked = bool(fault) or CHECKSUM in parsed(folder.read(MANIFEST))
    if checked:  # earlier versions wrote neither copies nor digests of timings
        yield from _faults_beside(folder, solved=bool(manifest.solve))
    checks, present = list(_checks(folder, manifest, checked=checked)), set(folder.names())
    yield from (Fault(check.name, "is missing") for check in checks if check.name not in present)
    foreign = sorted(present - {check.name for check in checks})
    checks = [check for check in checks if check.name in present]
    checks += [Check(name, "foreign") for name in foreign if not BESIDE.fullmatch(name)]
    progress.expect(sum(check.counted for check in checks))
    for check, faults in workers.work(_faults, checks, lambda c: _read(folder, c), progress):
        yield from faults
        progress.done(check.counted)


def repair(
    where: Where | Folder,
    *,
    yes: bool = False,
    workers: Workers | None = None,
    progress: Progress = SILENT,
) -> list[Fault]:
    """Do again exactly the shards that have faults, set foreign files aside, and return the faults.

    Damaged files that are replaced are kept in ``_damaged/``, foreign ones in ``_foreign/``. Files
    with sound rows that are not what the manifest says are set aside with ``yes`` only. InputErrors
    and ProlearnErrors are as in ``solve``.
    """
    folder, workers = open_folder(where), workers or Workers()
    manifest_or_copy(folder)  # before the lock, which would make a folder
    with sole_writer(folder, OWNED):
        manifest, _ = manifest_or_copy(folder)
        refuse_versions(folder, manifest)
        faults = list(verify(folder, workers=workers, progress=progress))
        left = {fault.path for fault in faults if fault.sound and not yes}
        for fault in faults:
            # Files of a run that was cut short may be sound; copies are written anew.
            replaced = fault.path in (COPY, TIMED) or fault.what in (CUT_SHORT, UNTIMED)
            if fault.path not in left and not replaced and folder.exists(fault.path):
                set_aside(folder, fault.path, progress, *[FOREIGN] * fault.foreign)
        with committed(Ledger(folder, manifest, progress)) as ledger:
            # Timings come from solving, so that the plan goes with them.
            ledger.drop(f.path.removeprefix(TIMINGS) for f in faults if f.path not in left)
            complete(ledger, workers, progress, leave=left)
    return faults


def _faults_beside(folder: Folder, *, solved: bool) -> Iterator[Fault]:
    """Faults of the manifest's copy and of the digests of timings."""
    content: dict[str, bytes] = {}
    for name in (COPY, MANIFEST):
        with suppress(OSError):
            content[name] = folder.read(name)
    if content.get(COPY) != content.get(MANIFEST):
        yield Fault(COPY, f"is not what {MANIFEST} is")
    if read_timed(folder) is None and (solved or folder.exists(TIMED)):
        yield Fault(TIMED, "is missing or damaged")


def _checks(folder: Folder, manifest: Manifest, *, checked: bool) -> Iterator[Check]:
    """Every file that is meant to be there; of an earlier version, timings where there are any."""
    known, timed = manifest.shards, read_timed(folder) or {}
    for shard in manifest.expected():
        rows, drawn, solved = len(shard.rows), known.get(shard.scenarios), known.get(shard.solved)
        counted = 0 if manifest.solve else rows
        yield Check(shard.scenarios, "scenarios", shard, drawn, counted=counted)
        if manifest.solve:
            yield Check(shard.solved, "solved", shard, solved, counted=rows)
            if checked:
                yield Check(shard.timings, "timings", shard, timed.get(shard.solved), solved)
            elif folder.exists(shard.timings):
                yield Check(shard.timings, "timings", shard)


def _read(folder: Folder, check: Check) -> bytes | str:
    """A file's content, or why it is not read; nothing of a foreign file that is no shard."""
    if check.kind == "foreign" and not SHARD.fullmatch(check.name):
        return b""
    if folder.size(check.name) > MOST_BYTES:
        return f"it is larger than {MOST_BYTES // 2**20} MiB"
    try:
        return folder.read(check.name)
    except OSError as error:
        return folder.reason(error)


def _faults(check: Check, content: bytes | str) -> list[Fault]:
    name, shard = check.name, check.shard
    if shard is None:
        alone = isinstance(content, bytes) and stands_alone(content)
        return [Fault(name, NOT_EXPECTED, foreign=True, sound=alone)]
    if isinstance(content, str):
        return [Fault(name, f"cannot be read ({content})")]
    timings = check.kind == "timings"
    if check.digest is None and not timings:
        return [Fault(name, CUT_SHORT)]
    right = check.digest in (None, digest_of(content))
    if timings and not right:
        return [Fault(name, f"does not have the digest that {TIMED} gives it")]
    try:
        table = decode(content, shard.most)
    except InputError as error:
        return [Fault(name, str(error), sound=not timings and stands_alone(content))]
    other = _mismatch(table, check, shard)
    if other or not right:
        alone = bool(other) and not timings and stands_alone(content)
        return [Fault(name, other if right else DIGEST, sound=alone)]
    splits, faults = [split for split, _ in shard.sample.drawn_as(shard.rows)], []
    if not timings and table["split"].to_pylist() != splits:
        faults.append("has rows of other splits than they were drawn for")
    if check.kind == "solved":
        requirements = requirements_of(shard.about.solve)
        faults += row_faults(table, shard.n, shard.about.problem, requirements)
    return [Fault(name, what) for what in faults]


def _mismatch(table: pa.Table, check: Check, shard: Shard) -> str:
    """Why a table is another than its shard is meant to have, or nothing."""
    if not table.schema.equals(pa.schema(FIELDS[check.kind])):
        return "has other columns than a dataset of this version"
    if check.kind != "timings" and not has_metadata(table, shard.metadata(check.name)):
        return "was made with other settings or versions than the manifest has"
    if table["scenario_id"].to_pylist() != shard.scenario_ids:
        return f"has other rows than the {len(shard.rows)} that the manifest expects"
    if check.solved is not None:
        if (table.schema.metadata or {}).get(TIMED_KEY) != check.solved.encode():
            return f"is not of {shard.solved} as the manifest has it"
        if check.digest is None:
            return UNTIMED
    return ""
