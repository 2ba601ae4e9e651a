"""A Monte Carlo of one transfer: trials in portions, portions into shards of a folder.

    FOLDER/loop=open-loop/part-00000.parquet            a row a trial
    FOLDER/_timings/loop=open-loop/part-00000.parquet   how long its plans took

and what any folder of shards has (pipeline/storage/layout.py). A shard says in its schema's
metadata all that decides its bytes. One that is there, has its digest and is of the same settings
is kept, so that a run that was killed goes on, and more trials come on top.
"""

import json
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from pipeline.errors import InputError
from pipeline.flight.closed_loop import ClosedLoop
from pipeline.flight.errors import draws
from pipeline.flight.portions import MADE_BY, OWNED, Loop, Manifest, MonteCarlo, Portion
from pipeline.flight.trials import Flown, OpenLoop, fly_trials
from pipeline.jobs.worker import check_worker
from pipeline.jobs.workers import Workers
from pipeline.progress import SILENT, Progress
from pipeline.provenance import refuse_change, refuse_other_versions
from pipeline.storage.checked import read_checked
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.layout import COPY, MANIFEST, TIMINGS
from pipeline.storage.ledger import Ledger, written
from pipeline.storage.shards import (
    METADATA_KEY,
    TIMED_KEY,
    decode,
    digest_of,
    encode,
    has_metadata,
    told_by,
)
from pipeline.storage.sound import sound_table

MOST_TRIALS = 10_000_000
"""Of one Monte Carlo."""

FIELDS = [
    pa.field("trial", pa.int64(), nullable=False),
    pa.field("min_separation", pa.float64()),
    pa.field("first_craft", pa.int32()),
    pa.field("second_craft", pa.int32()),
    pa.field("min_separation_time", pa.float64()),
    pa.field("goal_error", pa.float64(), nullable=False),
    pa.field("goal_velocity_error", pa.float64(), nullable=False),
    pa.field("delta_v", pa.float64(), nullable=False),
    pa.field("missed_burns", pa.int32(), nullable=False),
    pa.field("unsafe_replans", pa.int32(), nullable=False),
]
"""Columns; those of the closest pair are null for a single craft."""

TIMING_FIELDS = [
    pa.field("trial", pa.int64(), nullable=False),
    pa.field("replan_seconds", pa.list_(pa.field("element", pa.float64(), nullable=False))),
]


@dataclass(frozen=True)
class Shard:
    """A portion that is flown, as bytes, with its timings."""

    content: bytes
    timings: bytes


def fly_all(
    where: Where | Folder,
    of: MonteCarlo,
    loops: Sequence[Loop],
    trials: int,
    *,
    workers: Workers | None = None,
    progress: Progress = SILENT,
) -> dict[str, pa.Table]:
    """Fly what is not flown yet; the trials of each loop, by its name.

    Args:
        where: folder, new or begun with the same settings.
        of: what is flown.
        loops: in how many ways.
        trials: of each.
        workers: what to fly with; all cores of this machine by default.
        progress: told how far it is.

    Raises:
        InputError: for no trials, where another process writes to the folder, or where it was
            begun with other settings or versions.
        ProlearnError: where the folder cannot be written to or workers are killed again and again.
    """
    if not 1 <= trials <= MOST_TRIALS:
        raise InputError(f"trials is {trials}; expected 1 to {MOST_TRIALS}.")
    folder, workers = open_folder(where), workers or Workers()
    with written(folder, OWNED, lambda: _begun(folder), progress) as ledger:
        wanted = [
            portion
            for loop in loops
            for portion in _portions(of, loop, trials)
            if not _is_done(ledger, portion)
        ]
        progress.expect(sum(len(portion.trials) for portion in wanted))
        results = workers.work(_flown, wanted, lambda portion: b"", progress)
        with closing(results):
            for portion, shard in results:
                ledger.publish(portion.path, shard.content, shard.timings)
                progress.done(len(portion.trials))
        return {loop.name: _read(ledger, of, loop, trials) for loop in loops}


def _begun(folder: Folder) -> Manifest:
    """The manifest of the folder; without one its shards speak for themselves."""
    for name in (MANIFEST, COPY):
        with suppress(OSError, ValueError, KeyError, TypeError):
            return Manifest(dict(read_checked(folder, name)["shards"]))
    return Manifest({})


def _portions(of: MonteCarlo, loop: Loop, trials: int) -> Iterator[Portion]:
    for number, first in enumerate(range(0, trials, of.portion)):
        yield Portion(of, loop, number, range(first, min(first + of.portion, trials)))


def _is_done(ledger: Ledger[Manifest], portion: Portion) -> bool:
    """Whether a shard is there, sound, with its timings and the rows that are asked for.

    Raises:
        InputError: where it was made with other settings or versions.
    """
    name, folder = portion.path, ledger.folder
    try:
        content, timings = folder.read(name), folder.read(TIMINGS + name)
        table = decode(content, portion.most)
    except (OSError, InputError):
        return False
    if ledger.manifest.shards.get(name, digest_of(content)) != digest_of(content):
        return False
    if not has_metadata(table, portion.metadata):
        _refuse_change(folder, table, portion)
        return False  # it is another part of the same
    if name not in ledger.manifest.shards and encode(table) == content:
        ledger.adopt(name, content, portion.most)
    if ledger.timed.get(name) != digest_of(timings):
        return False
    first, rows = portion.trials.start, table.num_rows
    whole = table["trial"].to_pylist() == list(range(first, first + rows))
    return whole and rows >= len(portion.trials)


def _refuse_change(folder: Folder, table: pa.Table, portion: Portion) -> None:
    was, now = told_by(table), json.loads(portion.metadata[METADATA_KEY])
    was["part"] = now["part"]
    versions = was.pop("made_with", {}), now.pop("made_with")
    refuse_change(f"{portion.path} in {folder}", was, now)
    refuse_other_versions(f"{portion.path} in {folder} was flown", *versions)


def _flown(portion: Portion, _: bytes) -> Shard:
    of, loop = portion.of, portion.loop
    check_worker(of.made_with, MADE_BY)
    scenario, trials = of.scenario, portion.trials
    drawn = draws(of.seed, trials, scenario.n, scenario.problem.intervals)
    if loop.planner is None:
        flown = fly_trials(scenario, of.world, OpenLoop(loop.controls), drawn, of.errors)
        unsafe, seconds = np.zeros(len(trials), dtype=int), np.zeros((len(trials), 0))
    else:
        guide = ClosedLoop(scenario, loop.controls, loop.planner, len(trials), loop.margin)
        flown = fly_trials(scenario, of.world, guide, drawn, of.errors)
        unsafe, seconds = guide.unsafe, guide.seconds
    columns = _columns(trials, flown) | {"unsafe_replans": unsafe}
    table = pa.table(columns, schema=pa.schema(FIELDS, metadata=portion.metadata))
    made = [row[np.isfinite(row)] for row in seconds]
    content = encode(table)
    timings = pa.table(
        {"trial": np.array(trials), "replan_seconds": made},
        schema=pa.schema(TIMING_FIELDS, metadata={TIMED_KEY: digest_of(content)}),
    )
    return Shard(content, encode(timings))


def _columns(trials: range, flown: Flown) -> dict[str, Any]:
    least = flown.nearest
    alone = least.first < 0
    pair = {
        "min_separation": least.distance,
        "first_craft": least.first,
        "second_craft": least.second,
        "min_separation_time": least.time,
    }
    return {
        "trial": np.array(trials),
        **{name: pa.array(values, mask=alone) for name, values in pair.items()},
        "goal_error": flown.goal_error,
        "goal_velocity_error": flown.goal_velocity_error,
        "delta_v": flown.delta_v,
        "missed_burns": flown.missed,
    }


def _read(ledger: Ledger[Manifest], of: MonteCarlo, loop: Loop, trials: int) -> pa.Table:
    """The first so many trials of a loop, with what their plans took."""
    portions, known = list(_portions(of, loop, trials)), ledger.manifest.shards
    rows = [_sound(ledger, one, one.path, known[one.path]) for one in portions]
    taken = [_sound(ledger, one, TIMINGS + one.path, ledger.timed[one.path]) for one in portions]
    seconds = pa.concat_tables(taken)["replan_seconds"]
    return pa.concat_tables(rows).append_column("replan_seconds", seconds).slice(0, trials)


def _sound(ledger: Ledger[Manifest], portion: Portion, name: str, digest: str) -> pa.Table:
    try:
        return sound_table(ledger.folder, name, digest, portion.most)
    except InputError as error:
        raise InputError(
            f"{name} in {ledger.folder} {error}; give the same command again."
        ) from error
