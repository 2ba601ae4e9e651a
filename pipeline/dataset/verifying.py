"""Verification of a dataset, of its files and of their rows, and its repair."""

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
    MOST_BYTES,
    OTHER_FILES,
    OWNED,
    SCENARIOS,
    SHARD,
    Manifest,
    Shard,
    manifest_or_copy,
    requirements_of,
)
from pipeline.dataset.physics import row_faults
from pipeline.errors import InputError, ProlearnError
from pipeline.parallel.workers import ALL_CORES, Workers
from pipeline.storage import COPY, FOREIGN, MANIFEST, TIMED, TIMINGS, shards
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.ledger import open_ledger, read_timing_digests, set_aside, sole_writer
from pipeline.storage.shared import work_on

DIGEST = "does not have the digest that the manifest gives it"
CUT_SHORT = "is not in the manifest; the run that made it was cut short"
UNTIMED = f"is not listed in {TIMED}"
TIMED_AGAIN = f"is intact, but not the one listed in {TIMED}; two runs at once made it"
# Faults of files that a run left which was cut short or ran beside another; they are not set aside
REPLACED = (CUT_SHORT, UNTIMED, TIMED_AGAIN)
NOT_EXPECTED = "does not belong to this dataset"
FIELDS = {
    "scenarios": schema.SCENARIO_FIELDS,
    "solved": schema.SOLVED_FIELDS,
    "timings": schema.TIMING_FIELDS,
}


def is_sound_shard(content: bytes) -> bool:
    """Whether bytes are a shard with sound rows, of this or any other dataset."""
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
    except (InputError, ValueError):  # as of other columns or several swarm sizes
        return False


@dataclass(frozen=True, order=True)
class Fault:
    """A fault of a dataset; in order of files, since workers find them in any order."""

    path: str  # the file, inside the folder
    what: str  # what is wrong with it
    foreign: bool = False  # whether it does not belong there at all
    # Whether it holds sound rows or their timings all the same, to be replaced with ``yes`` only
    sound: bool = False


@dataclass(frozen=True)
class Check:
    """A file to be checked."""

    name: str  # the file
    kind: Literal["scenarios", "solved", "timings", "foreign"]  # of its content
    shard: Shard | None = None  # that it is meant to hold, or None where it is foreign
    digest: str | None = None  # that the manifest gives it, or None
    counted: int = 0  # rows of progress: those of a scenario file count only before the solve


Checks = tuple[Check, ...]
"""Files that are checked together: those of one shard, scenarios first, or a foreign one."""


def verify(where: Where | Folder, *, workers: Workers = ALL_CORES) -> Iterator[Fault]:
    """Every fault of a dataset, solved or not, as it is found; InputError without a manifest."""
    folder = open_folder(where)
    manifest, fault = manifest_or_copy(folder)
    if fault:
        yield Fault(MANIFEST, fault)
    yield from _manifest_faults(folder, solved=bool(manifest.solve))
    checks, listed = list(_checks(folder, manifest)), set(folder.names())
    foreign = sorted(listed - {check.name for check in checks})
    # What is in a folder that is a link is not listed, and there all the same.
    present = {c.name for c in checks if c.name in listed or folder.exists(c.name)}
    yield from (Fault(check.name, "is missing") for check in checks if check.name not in present)
    checks = [check for check in checks if check.name in present]
    checks += [Check(name, "foreign") for name in foreign if not OTHER_FILES.fullmatch(name)]
    workers.progress.expect(sum(check.counted for check in checks))
    groups = groupby(checks, lambda check: check.shard.solved if check.shard else check.name)
    tasks = [tuple(group) for _, group in groups]
    with closing(work_on(folder, workers, _faults, tasks, _read)) as results:
        for some, faults in results:
            yield from faults
            workers.progress.done(sum(check.counted for check in some))


def repair(
    where: Where | Folder, *, yes: bool = False, workers: Workers = ALL_CORES
) -> list[Fault]:
    """Make exactly the faulty shards again, set foreign files aside, and return the faults.

    Damaged files that are replaced are kept in ``_damaged/``, foreign ones in ``_foreign/``. Files
    with sound rows that are not what the manifest says are set aside with ``yes`` only. InputError
    and ProlearnError as in ``solve``.
    """
    folder = open_folder(where)
    manifest_or_copy(folder)  # before the lock, which would make a folder
    with sole_writer(folder, OWNED):
        manifest, _ = manifest_or_copy(folder)
        refuse_versions(folder, manifest)
        faults = sorted(verify(folder, workers=workers))
        spared = {fault.path for fault in faults if fault.sound and not yes}
        spared |= {TIMINGS + path.removeprefix(SCENARIOS) for path in spared}
        present = {path for path in spared if folder.exists(path)}
        faults = [replace(f, sound=f.sound or f.path in present) for f in faults]
        for fault in faults:
            replaced = fault.path in (COPY, TIMED) or fault.what in REPLACED
            if fault.path not in spared and not replaced and folder.exists(fault.path):
                workers.progress.say(set_aside(folder, fault.path, *[FOREIGN] * fault.foreign))
        with open_ledger(folder, manifest.fields(), workers.progress) as ledger:
            # New timings take a new solve, so plans with faulty timings are dropped too.
            ledger.drop(f.path.removeprefix(TIMINGS) for f in faults if f.path not in spared)
            complete(manifest, ledger, workers, spared)
    return faults


def _manifest_faults(folder: Folder, *, solved: bool) -> Iterator[Fault]:
    """Faults of the manifest's copy and of the digests of timings."""
    content: dict[str, bytes] = {}
    for name in (COPY, MANIFEST):
        with suppress(OSError):
            content[name] = folder.read(name)
    if content.get(COPY) != content.get(MANIFEST):
        yield Fault(COPY, f"is not what {MANIFEST} is")
    if read_timing_digests(folder) is None and (solved or folder.exists(TIMED)):
        yield Fault(TIMED, "is missing or damaged")


def _checks(folder: Folder, manifest: Manifest) -> Iterator[Check]:
    """Every file that is meant to be there."""
    known, timed = manifest.shards, read_timing_digests(folder) or {}
    for shard in manifest.expected():
        drawn, rows = known.get(shard.scenarios), len(shard.rows)
        yield Check(shard.scenarios, "scenarios", shard, drawn, 0 if manifest.solve else rows)
        if manifest.solve:
            yield Check(shard.solved, "solved", shard, shard.digest or None, rows)
            yield Check(TIMINGS + shard.solved, "timings", shard, timed.get(shard.solved))


def _read(folder: Folder, checks: Checks) -> list[bytes | str]:
    """Content of each file, or why it cannot be read; empty for a foreign file that is no shard."""

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
            texts = _row_faults(table, check.kind, check.shard)
            faults += [Fault(check.name, text) for text in texts]
            if check.kind == "solved" and "scenarios" in tables:
                faults += _scenario_faults(table, tables["scenarios"], check.shard)
    return faults


def _decoded(check: Check, content: bytes | str) -> pa.Table | Fault:
    """The table of a file, or why it is not what its shard must hold."""
    name, shard = check.name, check.shard
    if shard is None:
        sound = isinstance(content, bytes) and is_sound_shard(content)
        return Fault(name, NOT_EXPECTED, foreign=True, sound=sound)
    if isinstance(content, str):
        return Fault(name, f"cannot be read ({content})")
    timings = check.kind == "timings"
    if check.digest is None and not timings:
        return Fault(name, CUT_SHORT)
    has_digest = check.digest in (None, shards.digest_of(content))
    table = None
    try:
        table = shards.decode(content, shard.most)
        mismatch = _mismatch(table, check, shard)
    except InputError as error:
        mismatch = str(error)
    if has_digest and not mismatch:
        return table
    if not timings:
        what = mismatch if has_digest or table is None else DIGEST
        return Fault(name, what, sound=bool(mismatch) and is_sound_shard(content))
    if has_digest:
        return Fault(name, mismatch)
    # Another run's timings of this solved shard are undamaged if they are encoded to the same
    # bytes: not every byte has a checksum.
    intact = not mismatch and shard.digest and shards.encode(table) == content
    return Fault(name, TIMED_AGAIN if intact else f"does not have the digest that {TIMED} gives it")


def _row_faults(table: pa.Table, kind: str, shard: Shard) -> Iterator[str]:
    if kind == "timings":
        return
    if table["split"].to_pylist() != [split for split, _ in shard.sample.drawn_as(shard.rows)]:
        yield "has rows of other splits than the manifest expects"
    if {*table["n_spacecraft"].to_pylist()} != {shard.n}:
        yield f"has rows of other swarm sizes than {shard.n}"
    if {*table["family"].to_pylist()} != {shard.sample.family}:
        yield f"has rows of other families than {shard.sample.family}"
    try:
        ends = [schema.stacked(table, end, shard.n, 6) for end in ("initial", "goal")]
    except ValueError:
        yield "has initial or goal states of another shape"
    else:
        if not np.isfinite(ends).all():
            yield "has initial or goal states that are not finite numbers"
    if kind == "solved":
        requirements = requirements_of(shard.manifest.solve)
        yield from row_faults(table, shard.n, shard.manifest.problem, requirements)


def _scenario_faults(solved: pa.Table, scenarios: pa.Table, shard: Shard) -> Iterator[Fault]:
    """Faults where solved rows and the scenario file differ: which of the two files is wrong."""
    if schema.same_scenarios(solved, scenarios):
        return
    try:
        expected = drawn_table(shard)
    except ProlearnError:  # of another version, say
        yield Fault(shard.solved, f"has other scenarios than {shard.scenarios}")
        return
    for path, rows in ((shard.solved, solved), (shard.scenarios, scenarios)):
        if not schema.same_scenarios(rows, expected):
            yield Fault(path, "has other scenarios than the manifest expects")


def _mismatch(table: pa.Table, check: Check, shard: Shard) -> str:
    """How a table differs from what its shard must hold; empty where it does not."""
    if not table.schema.equals(pa.schema(FIELDS[check.kind])):
        return "has other columns than a dataset of this version"
    if check.kind != "timings" and not shards.has_metadata(table, shard.metadata(check.name)):
        return "was made with other settings or versions than the manifest has"
    if table["scenario_id"].to_pylist() != shard.scenario_ids:
        return f"has other rows than the {len(shard.rows)} that the manifest expects"
    if check.kind == "timings" and shard.digest:
        if (table.schema.metadata or {}).get(shards.TIMED_KEY) != shard.digest.encode():
            return f"is not of {shard.solved} as the manifest has it"
        if check.digest is None:
            return UNTIMED
    return ""
