"""Every fault of a dataset, of its files and of their rows, and the repair of faults."""

from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Literal

import numpy as np
import pyarrow as pa

from pipeline.dataset import schema
from pipeline.dataset.making import complete, drawn_table, refuse_versions
from pipeline.dataset.manifest import (
    BESIDE,
    MOST_BYTES,
    OWNED,
    SCENARIOS,
    SHARD,
    Manifest,
    Shard,
    manifest_or_copy,
    requirements_of,
)
from pipeline.dataset.physics import row_faults
from pipeline.documents import CHECKSUM, parse_json
from pipeline.errors import InputError, ProlearnError
from pipeline.parallel.workers import Workers
from pipeline.progress import SILENT, Progress
from pipeline.storage import COPY, FOREIGN, MANIFEST, TIMED, TIMINGS, shards
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.ledger import Ledger, committed, read_timed, set_aside, sole_writer
from pipeline.storage.shared import work_on

DIGEST = "does not have the digest that the manifest gives it"
CUT_SHORT = "is not in the manifest; the run that made it was cut short"
UNTIMED = f"is not in {TIMED}"
TIMED_AGAIN = f"is whole, but not the one that {TIMED} has; two runs at once made it"
# Files of a run that was cut short, or ran beside another, may be sound; copies are written anew.
REPLACED = (CUT_SHORT, UNTIMED, TIMED_AGAIN)
NOT_EXPECTED = "does not belong to this dataset"
FIELDS = {
    "scenarios": schema.SCENARIO_FIELDS,
    "solved": schema.SOLVED_FIELDS,
    "timings": schema.TIMING_FIELDS,
}


def stands_alone(content: bytes) -> bool:
    """Whether bytes are a shard with sound rows, of whatever dataset."""
    try:
        # Rows take at least 32 bytes, and numbers one, however well they are packed.
        table = shards.decode(content, shards.Size(rows=len(content) // 32, values=len(content)))
        solved = table.schema.equals(pa.schema(schema.SOLVED_FIELDS))
        if not solved and not table.schema.equals(pa.schema(schema.SCENARIO_FIELDS)):
            return False
        (n,) = {*table["n_spacecraft"].to_pylist()}
        if {scenario.n for scenario in schema.scenarios_of(table)} != {n}:
            return False
        requirements = requirements_of(shards.read_metadata(table))
        return not (solved and any(row_faults(table, n, schema.problem_of(table), requirements)))
    except (InputError, ValueError):  # other columns have no shape, and other rows no one size
        return False


@dataclass(frozen=True)
class Fault:
    """A fault of a dataset."""

    path: str  # the file, inside the folder
    what: str  # what is wrong with it
    foreign: bool = False  # whether it does not belong there at all
    # Whether it holds sound rows all the same, or their timings, which are not given up unasked
    sound: bool = False


@dataclass(frozen=True)
class Check:
    """A file to be checked."""

    name: str  # the file
    kind: Literal["scenarios", "solved", "timings", "foreign"]  # of its content
    shard: Shard | None = None  # that it is meant to hold, or None where it is foreign
    digest: str | None = None  # that the manifest gives it, or None
    solved: str | None = None  # of timings, the digest of the solved instances
    counted: int = 0  # rows that it counts for; a scenario that is solved counts once


Checks = tuple[Check, ...]
"""Of files that are checked together: of one shard, its scenarios first, or a foreign one."""


def verify(
    where: Where | Folder, *, workers: Workers | None = None, progress: Progress = SILENT
) -> Iterator[Fault]:
    """Every fault of a dataset, solved or not, as it is found; InputError without a manifest."""
    folder, workers = open_folder(where), workers or Workers()
    manifest, fault = manifest_or_copy(folder)
    if fault:
        yield Fault(MANIFEST, fault)
    checked = bool(fault) or CHECKSUM in parse_json(folder.read(MANIFEST))
    if checked:  # earlier versions wrote neither copies nor digests of timings
        yield from _faults_beside(folder, solved=bool(manifest.solve))
    checks, present = list(_checks(folder, manifest, checked=checked)), set(folder.names())
    yield from (Fault(check.name, "is missing") for check in checks if check.name not in present)
    foreign = sorted(present - {check.name for check in checks})
    checks = [check for check in checks if check.name in present]
    checks += [Check(name, "foreign") for name in foreign if not BESIDE.fullmatch(name)]
    progress.expect(sum(check.counted for check in checks))
    groups = groupby(checks, lambda check: check.shard.solved if check.shard else check.name)
    tasks = [tuple(group) for _, group in groups]
    with closing(work_on(folder, workers, _faults, tasks, _read, progress)) as results:
        for some, faults in results:
            yield from faults
            progress.done(sum(check.counted for check in some))


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
        left |= {TIMINGS + path.removeprefix(SCENARIOS) for path in left}
        kept = {path for path in left if folder.exists(path)}
        faults = [replace(f, sound=f.sound or f.path in kept) for f in faults]
        for fault in faults:
            replaced = fault.path in (COPY, TIMED) or fault.what in REPLACED
            if fault.path not in left and not replaced and folder.exists(fault.path):
                progress.say(set_aside(folder, fault.path, *[FOREIGN] * fault.foreign))
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


def _read(folder: Folder, checks: Checks) -> list[bytes | str]:
    """Files' contents, or why one is not read; nothing of a foreign file that is no shard."""

    def content(check: Check) -> bytes | str:
        if check.kind == "foreign" and not SHARD.fullmatch(check.name):
            return b""
        if folder.size(check.name) > MOST_BYTES:
            return f"it is larger than {MOST_BYTES // 2**20} MiB"
        try:
            return folder.read(check.name)
        except OSError as error:
            return folder.reason(error)

    return [content(check) for check in checks]


def _faults(checks: Checks, contents: Sequence[bytes | str]) -> list[Fault]:
    """Faults of all files of one shard, or of a foreign file."""
    tables, faults = {}, []
    for check, content in zip(checks, contents, strict=True):
        table = _decoded(check, content)
        if isinstance(table, Fault):
            faults.append(table)
            continue
        tables[check.kind] = table
        if check.shard:
            faults += [Fault(check.name, what) for what in _wrong(table, check.kind, check.shard)]
            if check.kind == "solved" and "scenarios" in tables:
                faults += _other_scenarios(table, tables["scenarios"], check.shard)
    return faults


def _decoded(check: Check, content: bytes | str) -> pa.Table | Fault:
    """The table of a file, or why it is not what its shard must hold."""
    name, shard = check.name, check.shard
    if shard is None:
        alone = isinstance(content, bytes) and stands_alone(content)
        return Fault(name, NOT_EXPECTED, foreign=True, sound=alone)
    if isinstance(content, str):
        return Fault(name, f"cannot be read ({content})")
    timings = check.kind == "timings"
    if check.digest is None and not timings:
        return Fault(name, CUT_SHORT)
    right = check.digest in (None, shards.digest_of(content))
    table = None
    try:
        table = shards.decode(content, shard.most)
        other = _mismatch(table, check, shard)
    except InputError as error:
        other = str(error)
    if right and not other:
        return table
    if not timings:
        what = other if right or table is None else DIGEST
        return Fault(name, what, sound=bool(other) and stands_alone(content))
    if right:
        return Fault(name, other)
    # Timings of this solved shard that another run wrote are undamaged if they are encoded to the
    # same bytes, not all of which have a checksum.
    again = not other and check.solved is not None and shards.encode(table) == content
    return Fault(name, TIMED_AGAIN if again else f"does not have the digest that {TIMED} gives it")


def _wrong(table: pa.Table, kind: str, shard: Shard) -> Iterator[str]:
    """What is wrong with the rows of a shard."""
    if kind == "timings":
        return
    if table["split"].to_pylist() != [split for split, _ in shard.sample.drawn_as(shard.rows)]:
        yield "has rows of other splits than they were drawn for"
    if {*table["n_spacecraft"].to_pylist()} != {shard.n}:
        yield f"has rows of other swarm sizes than {shard.n}"
    if {*table["family"].to_pylist()} != {shard.sample.family}:
        yield f"has rows of other families than {shard.sample.family}"
    try:
        ends = [schema.stacked(table, end, shard.n, 6) for end in ("initial", "goal")]
    except ValueError:
        yield "has ends of another shape"
    else:
        if not np.isfinite(ends).all():
            yield "has ends that are not finite numbers"
    if kind == "solved":
        requirements = requirements_of(shard.about.solve)
        yield from row_faults(table, shard.n, shard.about.problem, requirements)


def _other_scenarios(solved: pa.Table, scenarios: pa.Table, shard: Shard) -> Iterator[Fault]:
    """Faults where solved rows have other scenarios than drawn: which of the two files is wrong."""
    if schema.same_scenarios(solved, scenarios):
        return
    try:
        right = drawn_table(shard)
    except ProlearnError:  # of another version, say
        yield Fault(shard.solved, f"has other scenarios than {shard.scenarios}")
        return
    for path, rows in ((shard.solved, solved), (shard.scenarios, scenarios)):
        if not schema.same_scenarios(rows, right):
            yield Fault(path, "has other scenarios than are drawn for it")


def _mismatch(table: pa.Table, check: Check, shard: Shard) -> str:
    """How a table differs from what its shard must hold; empty where it does not."""
    if not table.schema.equals(pa.schema(FIELDS[check.kind])):
        return "has other columns than a dataset of this version"
    if check.kind != "timings" and not shards.has_metadata(table, shard.metadata(check.name)):
        return "was made with other settings or versions than the manifest has"
    if table["scenario_id"].to_pylist() != shard.scenario_ids:
        return f"has other rows than the {len(shard.rows)} that the manifest expects"
    if check.solved is not None:
        if (table.schema.metadata or {}).get(shards.TIMED_KEY) != check.solved.encode():
            return f"is not of {shard.solved} as the manifest has it"
        if check.digest is None:
            return UNTIMED
    return ""
