"""A Monte Carlo of one transfer, whose trials are written in portions to shards of a folder.

    FOLDER/loop=open-loop/part-00000.parquet            one row per trial
    FOLDER/_timings/loop=open-loop/part-00000.parquet   how long its plans took

and the other files of any folder of shards (pipeline/storage). The schema metadata of a shard have
all that decides its bytes. A shard that has its digest and the same settings is kept, so that a run
that was killed goes on, and trials can be added.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from typing import Any

import numpy as np
import pyarrow as pa

from pipeline.errors import InputError
from pipeline.flight.least_distances import OF_CORRIDORS, OF_CRAFT, OF_SIZES
from pipeline.flight.loops import Loop, TrialSettings
from pipeline.flight.trials import Trials
from pipeline.parallel.workers import ALL_CORES, Workers, check_worker
from pipeline.planners.planner import identity
from pipeline.provenance import FLIGHT, DecidedBy, made_with, refuse_change, refuse_other_versions
from pipeline.scenario import Scenario
from pipeline.storage import TIMINGS, shards
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.ledger import (
    Ledger,
    NewShard,
    listed_shards,
    open_ledger,
    sole_writer,
    write_shards,
)
from pipeline.storage.shards import Size, decode, digest_of, encode

SCHEMA = "prolearn.flight/2"
OWNED = rf"({TIMINGS})?loop=[\w-]+/part-\d{{5,}}\.parquet"  # pattern of the names of shards
# Packages, our own and others, that the bytes of trials depend on
_PACKAGES = ("numpy", "scipy", "pyarrow", "clarabel", "highspy", "torch")
MADE_BY: DecidedBy = FLIGHT, _PACKAGES


def _of_distance(names: Sequence[str]) -> list[pa.Field]:
    """Columns of a distance, two numbers and a time."""
    kinds = pa.float64(), pa.int32(), pa.int32(), pa.float64()
    return list(map(pa.field, names, kinds))


# Columns; those of the closest pair are null for a single craft.
FIELDS = [
    pa.field("trial", pa.int64(), nullable=False),
    *_of_distance(OF_CRAFT),
    pa.field("goal_error", pa.float64(), nullable=False),
    pa.field("goal_velocity_error", pa.float64(), nullable=False),
    pa.field("delta_v", pa.float64(), nullable=False),
    pa.field("missed_burns", pa.int32(), nullable=False),
    pa.field("unsafe_replans", pa.int32(), nullable=False),
    pa.field("lost_craft", pa.int32(), nullable=False),
    pa.field("lost_time", pa.float64(), nullable=False),
]
# Further columns where craft have sizes of their own or there are obstacles, or corridors
OF_UNLIKE = {names: _of_distance(names) for names in (OF_SIZES, OF_CORRIDORS)}
TIMING_FIELDS = [
    FIELDS[0],
    pa.field("replan_seconds", pa.list_(pa.field("element", pa.float64(), nullable=False))),
]


@dataclass(frozen=True, eq=False)
class Portion:
    """Some trials of a loop, the rows of a shard."""

    of: TrialSettings
    loop: Loop
    number: int
    rows: range
    made_with: Mapping[str, str]  # versions by name

    @property
    def path(self) -> str:
        """Path of its shard inside the folder."""
        return f"loop={self.loop.name.replace(' ', '-')}/part-{self.number:05d}.parquet"

    @property
    def metadata(self) -> dict[bytes, bytes]:
        """The schema metadata of its shard: all that decides its bytes."""
        of, loop = self.of, self.loop
        ends = [of.scenario.initial, of.scenario.goal, loop.controls]
        ends += [] if loop.states is None else [loop.states]
        plan = hashlib.sha256(b"".join(np.ascontiguousarray(one).tobytes() for one in ends))
        return shards.metadata_of(
            {
                "schema": SCHEMA,
                **of.scenario.problem.document(),
                "n_spacecraft": of.scenario.n,
                **_unlike(of.scenario),
                "plan": plan.hexdigest(),
                "seed": of.seed,
                "portion": of.portion_of(loop),
                "world": {"name": type(of.world).__name__, **asdict(of.world)},
                "errors": asdict(of.errors),
                "loop": loop.name,
                "planner": None if loop.planner is None else identity(loop.planner),
                "back_off": None if loop.back_off is None else asdict(loop.back_off),
                "part": self.number,
                "made_with": dict(self.made_with),
            }
        )

    @property
    def most(self) -> Size:
        """The largest size of its files."""
        portion = self.of.portion_of(self.loop)
        return Size(portion, portion * self.of.scenario.problem.intervals)


def fly_all(
    where: Where | Folder,
    of: TrialSettings,
    loops: Sequence[Loop],
    trials: int,
    *,
    workers: Workers = ALL_CORES,
) -> dict[str, Trials]:
    """Fly the trials of each loop that are not in the folder yet; all trials, by the loop's name.

    InputError for no trials, where another process writes to the folder, or where it was begun
    with other settings or versions. ProlearnError where the folder cannot be written to or workers
    are killed again and again.
    """
    versions = made_with(*MADE_BY)
    portions = {
        loop.name: [
            Portion(of, loop, number, rows, versions)
            for number, rows in enumerate(of.portions(loop, trials))
        ]
        for loop in loops
    }
    folder = open_folder(where)
    with sole_writer(folder, OWNED):
        fields = {"schema": SCHEMA, "shards": listed_shards(folder, SCHEMA)}
        with open_ledger(folder, fields, workers.progress) as ledger:
            every = chain.from_iterable(portions.values())
            wanted = [portion for portion in every if not _is_done(ledger, portion)]
            write_shards(ledger, _flown, wanted, workers)
            return {name: _read(ledger, some, trials) for name, some in portions.items()}


def _unlike(scenario: Scenario) -> dict[str, Any]:
    """Metadata of trials: radii, obstacles, corridors, and thrust limits of single craft."""
    found: dict[str, Any] = {}
    own = [one.max_acceleration for one in scenario.craft]
    if any(own) and not isinstance(scenario.problem.thrust.model, str):
        found["craft_max_acceleration"] = own
    if scenario.unlike:
        found["radii"] = scenario.radii.tolist()
        found["obstacles"] = {k: asdict(one) for k, one in enumerate(scenario.obstacles)}
        found["corridors"] = {k: asdict(one) for k, one in enumerate(scenario.corridors)}
    return found


def _is_done(ledger: Ledger, portion: Portion) -> bool:
    """Whether a shard of Monte Carlo trials is complete: undamaged, with timings and all rows.

    InputError where it was made with other settings or versions.
    """
    name, folder, listed = portion.path, ledger.folder, ledger.shards
    if name in listed and not ledger.is_sound(name):
        return False
    try:
        table = decode(folder.read(name), portion.most)
        timings = digest_of(folder.read(TIMINGS + name))
    except (OSError, InputError):
        return False
    if not shards.has_metadata(table, portion.metadata):
        _refuse_change(folder, table, portion)
        return False  # a part of the same run with another number
    if name not in listed and not ledger.adopt(name, portion.most, lambda _: True):
        return False
    first, rows = portion.rows.start, table.num_rows
    whole = table["trial"].to_pylist() == list(range(first, first + rows))
    return whole and rows >= len(portion.rows) and ledger.timing_digests.get(name) == timings


def _refuse_change(folder: Folder, table: pa.Table, portion: Portion) -> None:
    was, now = shards.read_metadata(table), json.loads(portion.metadata[shards.METADATA_KEY])
    was["part"] = now["part"]
    versions = was.pop("made_with", {}), now.pop("made_with")
    refuse_change(f"{portion.path} in {folder}", was, now)
    refuse_other_versions(f"{portion.path} in {folder} was flown", *versions)


def _flown(portion: Portion, _: bytes) -> NewShard:
    check_worker(portion.made_with, MADE_BY)
    flown = portion.of.fly(portion.loop, portion.rows)
    kinds = [OF_CRAFT, *(names for names in OF_UNLIKE if names[0] in flown)]
    none = {name: flown[names[1]] < 0 for names in kinds for name in names}
    fields = [*FIELDS, *(field for names in kinds[1:] for field in OF_UNLIKE[names])]
    columns = {
        field.name: pa.array(flown[field.name], mask=none.get(field.name)) for field in fields
    }
    content = encode(pa.table(columns, schema=pa.schema(fields, metadata=portion.metadata)))
    seconds = [row[np.isfinite(row)] for row in flown["replan_seconds"]]
    timings = pa.table(
        {"trial": np.array(portion.rows), "replan_seconds": seconds},
        schema=pa.schema(TIMING_FIELDS, metadata={shards.TIMED_KEY: digest_of(content)}),
    )
    return NewShard(portion.path, content, encode(timings))


def _read(ledger: Ledger, portions: Sequence[Portion], trials: int) -> Trials:
    """The first ``trials`` trials of a loop's portions, with the times of all their plans."""

    def sound(name: str, digest: str, most: Size) -> pa.Table:
        try:
            return decode(shards.read_verified(ledger.folder, name, digest), most)
        except InputError as error:
            wrong = f"{name} in {ledger.folder} {error}; give the same command again."
            raise InputError(wrong) from error

    def read(digests: Mapping[str, str], top: str = "") -> pa.Table:
        parts = [sound(top + one.path, digests[one.path], one.most) for one in portions]
        return pa.concat_tables(parts).slice(0, trials).combine_chunks()

    rows, seconds = read(ledger.shards), read(ledger.timing_digests, TIMINGS)["replan_seconds"]
    columns = {name: rows[name].to_numpy() for name in rows.column_names}
    return {**columns, "replan_seconds": seconds.combine_chunks().flatten().to_numpy()}
