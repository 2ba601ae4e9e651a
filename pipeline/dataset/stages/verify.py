"""Integrity of every shard and physics of every row of a dataset, as a list of faults."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import pyarrow as pa

from pipeline.dataset.format.layout import BESIDE, SHARD
from pipeline.dataset.format.manifest import Manifest, Shard, manifest_or_copy
from pipeline.dataset.format.schema import SCENARIO_FIELDS, SOLVED_FIELDS, TIMING_FIELDS
from pipeline.dataset.format.solving import requirements_of
from pipeline.dataset.stages.alone import stands_alone
from pipeline.dataset.stages.physics import row_faults
from pipeline.documents import CHECKSUM, parsed
from pipeline.errors import InputError
from pipeline.jobs.workers import Workers
from pipeline.progress import SILENT, Progress
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.layout import COPY, MANIFEST, TIMED
from pipeline.storage.ledger import read_timed
from pipeline.storage.shards import TIMED_KEY, decode, digest_of, has_metadata

DIGEST = "does not have the digest that the manifest gives it"
CUT_SHORT = "is not in the manifest; the run that made it was cut short"
UNTIMED = f"is not in {TIMED}"
FOREIGN = "does not belong to this dataset"

MOST_BYTES = 2**30
"""Size of the largest file that is read to be judged; shards have some MB."""


@dataclass(frozen=True)
class Fault:
    """Something wrong in a dataset.

    Attributes:
        path: the file, inside the folder.
        what: what is wrong with it.
        foreign: whether it does not belong there at all.
        sound: whether it holds sound rows all the same, which are not given up unasked.
    """

    path: str
    what: str
    foreign: bool = False
    sound: bool = False


@dataclass(frozen=True)
class Check:
    """A file to be judged, with what it is meant to be.

    Attributes:
        name: the file.
        kind: scenarios, solved instances or timings of a shard, or none of them.
        shard: what it is meant to hold, or None where it is foreign.
        digest: what the manifest says, or None where it says nothing.
        solved: of timings, the digest of the solved instances.
        counted: rows that it counts for; a scenario that is solved counts once.
    """

    name: str
    kind: Literal["scenarios", "solved", "timings", "foreign"]
    shard: Shard | None = None
    digest: str | None = None
    solved: str | None = None
    counted: int = 0


@dataclass(frozen=True)
class Unread:
    """Why a file is not read."""

    reason: str


def verify(
    where: Where | Folder, *, workers: Workers | None = None, progress: Progress = SILENT
) -> Iterator[Fault]:
    """Every fault of a dataset, as it is found.

    Args:
        where: a dataset; one that is sampled and not yet solved is judged as such.
        workers: what to verify it with; all cores of this machine by default.
        progress: told how far it is.

    Raises:
        InputError: where the folder holds no dataset, or neither its manifest nor the copy of
            that is sound.
    """
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
    for check, faults in workers.work(_judged, checks, lambda c: _read(folder, c), progress):
        yield from faults
        progress.done(check.counted)


def _faults_beside(folder: Folder, *, solved: bool) -> Iterator[Fault]:
    """Faults of the files that digests are in, but for the manifest."""
    manifest, copy = (_content(folder, name) for name in (MANIFEST, COPY))
    if copy != manifest:
        yield Fault(COPY, f"is not what {MANIFEST} is")
    if read_timed(folder) is None and (solved or folder.exists(TIMED)):
        yield Fault(TIMED, "is missing or damaged")


def _content(folder: Folder, name: str) -> bytes | None:
    try:
        return folder.read(name)
    except OSError:
        return None


def _checks(folder: Folder, manifest: Manifest, *, checked: bool) -> Iterator[Check]:
    """Every file that is meant to be there; of an earlier version, timings where there are any."""
    known, timed = manifest.shards, read_timed(folder) or {}
    for shard in manifest.expected():
        rows, solved = len(shard.rows), known.get(shard.solved)
        counted = 0 if manifest.solve else rows
        yield Check(
            shard.scenarios, "scenarios", shard, known.get(shard.scenarios), counted=counted
        )
        if manifest.solve:
            yield Check(shard.solved, "solved", shard, solved, counted=rows)
            if checked:
                digest = timed.get(shard.solved)
                yield Check(shard.timings, "timings", shard, digest, solved)
            elif folder.exists(shard.timings):
                yield Check(shard.timings, "timings", shard)


def _read(folder: Folder, check: Check) -> bytes | Unread:
    if check.kind == "foreign" and not SHARD.fullmatch(check.name):
        return b""
    if folder.size(check.name) > MOST_BYTES:
        return Unread(f"it is larger than {MOST_BYTES // 2**20} MiB")
    try:
        return folder.read(check.name)
    except OSError as error:
        return Unread(folder.told(error))


def _judged(check: Check, content: bytes | Unread) -> list[Fault]:
    """The faults of one file."""
    if check.shard is None:
        alone = isinstance(content, bytes) and stands_alone(content)
        return [Fault(check.name, FOREIGN, foreign=True, sound=alone)]
    if isinstance(content, Unread):
        return [Fault(check.name, f"cannot be read ({content.reason})")]
    if check.kind == "timings":
        return [Fault(check.name, what) for what in _timing_faults(check, check.shard, content)]
    if check.digest is None:
        return [Fault(check.name, CUT_SHORT)]
    return _shard_faults(check, check.shard, content)


def _shard_faults(check: Check, shard: Shard, content: bytes) -> list[Fault]:
    """The faults of scenarios or solved instances that the manifest has a digest of."""
    right = digest_of(content) == check.digest
    try:
        table = decode(content, shard.most)
    except InputError as error:
        return [Fault(check.name, str(error), sound=stands_alone(content))]
    fields = SOLVED_FIELDS if check.kind == "solved" else SCENARIO_FIELDS
    other = None
    if not table.schema.equals(pa.schema(fields)):
        other = "has other columns than a dataset of this version"
    elif not has_metadata(table, shard.metadata(check.name)):
        other = "was made with other settings or versions than the manifest has"
    elif table["scenario_id"].to_pylist() != shard.scenario_ids:
        other = f"has other rows than the {len(shard.rows)} that the manifest expects"
    if other:
        return [Fault(check.name, other if right else DIGEST, sound=stands_alone(content))]
    if not right:
        return [Fault(check.name, DIGEST)]
    return [Fault(check.name, what) for what in _row_faults(table, shard, check.kind)]


def _timing_faults(check: Check, shard: Shard, content: bytes) -> Iterator[str]:
    if check.digest is not None and digest_of(content) != check.digest:
        yield f"does not have the digest that {TIMED} gives it"
        return
    try:
        table = decode(content, shard.most)
    except InputError as error:
        yield str(error)
        return
    if not table.schema.equals(pa.schema(TIMING_FIELDS)):
        yield "has other columns than timings of this version"
    elif table["scenario_id"].to_pylist() != shard.scenario_ids:
        yield "is of other scenarios"
    elif check.solved is not None:
        if (table.schema.metadata or {}).get(TIMED_KEY) != check.solved.encode():
            yield f"is not of {shard.solved} as the manifest has it"
        elif check.digest is None:
            yield UNTIMED


def _row_faults(table: pa.Table, shard: Shard, kind: str) -> Iterator[str]:
    if table["split"].to_pylist() != [shard.sample.drawn_as(row)[0] for row in shard.rows]:
        yield "has rows of other splits than they were drawn for"
    if kind == "solved":
        requirements = requirements_of(shard.about.solve)
        yield from row_faults(table, shard.n, shard.about.problem, requirements)
