"""A Monte Carlo of one transfer: trials in portions, portions into shards of a folder.

    FOLDER/loop=open-loop/part-00000.parquet            a row a trial
    FOLDER/_timings/loop=open-loop/part-00000.parquet   how long its plans took, and its digest
    FOLDER/_lock, FOLDER/_writer                        held by the one who writes, and who that is

A shard says in its schema's metadata all that decides its bytes. One that is there, has its digest
and is of the same settings is kept, so that a run that was killed goes on, and more trials come on
top.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.dataset.format.schema import METADATA_KEY, has_metadata
from pipeline.errors import InputError
from pipeline.flight.closed_loop import ClosedLoop
from pipeline.flight.errors import Errors, draws
from pipeline.flight.trials import Flown, OpenLoop, fly_trials
from pipeline.flight.world import World
from pipeline.jobs.worker import check_worker
from pipeline.jobs.workers import Workers
from pipeline.orbit.approaches import MOST_PAIRS
from pipeline.planners.planner import Planner
from pipeline.progress import SILENT, Progress
from pipeline.provenance import DecidedBy, made_with, refuse_change, refuse_other_versions
from pipeline.scenario import Scenario
from pipeline.scenario.families import SEEDS
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.lock import sole_writer
from pipeline.storage.shards import decode, digest_of, encode, read_shard

SCHEMA = "prolearn.flight/1"

PORTION = 50
"""Most trials that are flown side by side, and rows of a shard."""

MADE_BY: DecidedBy = (
    ("orbit", "scenario", "plan", "expert", "networks", "planners", "flight"),
    ("numpy", "scipy", "pyarrow", "clarabel", "highspy"),
)
"""Code of ours and packages that the bytes of trials depend on."""

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

DIGEST_KEY = b"prolearn_shard"
"""In the metadata of timings: the SHA-256 digest of the shard that they belong to."""


@dataclass(frozen=True, eq=False)
class Loop:
    """A way to fly a transfer.

    Attributes:
        name: what tables and folders call it.
        controls: of the plan at the first node, m/s².
        planner: that plans anew at each node, or None where nobody does.
        margin: asked for beyond the collision radius when planning anew, m.
    """

    name: str
    controls: Float[Array, "n intervals 3"]
    planner: Planner | None = None
    margin: float = 0.0


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """All that decides what trials are, but how they are flown.

    Attributes:
        scenario: what the swarm is to do.
        world: in which it moves.
        errors: what goes wrong.
        seed: root seed.
        portion: trials in a shard.
    """

    scenario: Scenario
    world: World
    errors: Errors
    seed: int = 0
    portion: int = PORTION

    def __post_init__(self) -> None:
        """Refuse a seed that is none."""
        if not 0 <= self.seed < SEEDS:
            raise InputError(f"seed is {self.seed}; expected 0 to {SEEDS - 1}.")

    @cached_property
    def made_with(self) -> Mapping[str, str]:
        """Versions by name."""
        return made_with(*MADE_BY)

    def settings(self, loop: Loop) -> dict[str, Any]:
        """What decides the bytes of a loop's shards, versions apart."""
        ends = self.scenario.initial, self.scenario.goal, loop.controls
        digest = hashlib.sha256(b"".join(np.ascontiguousarray(one).tobytes() for one in ends))
        world: Any = self.world
        return {
            "schema": SCHEMA,
            **asdict(self.scenario.problem),
            "n_spacecraft": self.scenario.n,
            "plan": digest.hexdigest(),
            "seed": self.seed,
            "portion": self.portion,
            "world": {"name": type(world).__name__, **asdict(world)},
            "errors": asdict(self.errors),
            "loop": loop.name,
            "planner": None if loop.planner is None else loop.planner.name,
            "margin": loop.margin,
        }

    def metadata(self, loop: Loop) -> dict[bytes, bytes]:
        """The schema metadata of a loop's shards."""
        document = {**self.settings(loop), "made_with": dict(self.made_with)}
        return {METADATA_KEY: json.dumps(document, sort_keys=True, default=str).encode()}


@dataclass(frozen=True, eq=False)
class Portion:
    """Some trials of a loop.

    Attributes:
        of: the Monte Carlo.
        loop: how they are flown.
        number: which of its shards.
        trials: at most as many as a shard has rows.
    """

    of: MonteCarlo
    loop: Loop
    number: int
    trials: range

    @property
    def path(self) -> str:
        """Of its shard inside the folder."""
        loop = self.loop.name.replace(" ", "-")
        return f"loop={loop}/part-{self.number:05d}.parquet"

    @property
    def timings(self) -> str:
        """Path of how long plans took."""
        return f"_timings/{self.path}"


@dataclass(frozen=True)
class Shard:
    """A portion that is flown, as bytes, with its timings."""

    content: bytes
    timings: bytes


def portion_of(n: int) -> int:
    """Trials of n craft that are flown side by side: so few that their pairs fit in memory."""
    return max(1, min(PORTION, 2 * MOST_PAIRS // n**2))


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
    if trials < 1:
        raise InputError(f"trials is {trials}; expected at least one.")
    folder, workers = open_folder(where), workers or Workers()
    with sole_writer(folder):
        wanted = [
            portion
            for loop in loops
            for portion in _portions(of, loop, trials)
            if not _is_done(folder, portion)
        ]
        progress.expect(sum(len(portion.trials) for portion in wanted))
        results = workers.work(_flown, wanted, lambda portion: b"", progress)
        with closing(results):
            for portion, shard in results:
                folder.publish(portion.timings, shard.timings)
                folder.publish(portion.path, shard.content)
                progress.done(len(portion.trials))
        return {loop.name: _read(folder, of, loop, trials) for loop in loops}


def _portions(of: MonteCarlo, loop: Loop, trials: int) -> Iterator[Portion]:
    for number, first in enumerate(range(0, trials, of.portion)):
        yield Portion(of, loop, number, range(first, min(first + of.portion, trials)))


def _is_done(folder: Folder, portion: Portion) -> bool:
    """Whether a shard is there, whole, with the rows that are asked for.

    Raises:
        InputError: where it was made with other settings or versions.
    """
    if not (folder.exists(portion.path) and folder.exists(portion.timings)):
        return False
    try:
        content = folder.read(portion.path)
        table, timings = decode(content), decode(folder.read(portion.timings))
    except (OSError, InputError):
        return False
    if (timings.schema.metadata or {}).get(DIGEST_KEY) != digest_of(content).encode():
        return False
    if not has_metadata(table, portion.of.metadata(portion.loop)):
        _refuse(folder, table, portion)
    return table.num_rows >= len(portion.trials)


def _refuse(folder: Folder, table: pa.Table, portion: Portion) -> None:
    was = json.loads((table.schema.metadata or {}).get(METADATA_KEY, b"{}"))
    now = json.loads(portion.of.metadata(portion.loop)[METADATA_KEY])
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
    table = pa.table(columns, schema=pa.schema(FIELDS, metadata=of.metadata(loop)))
    made = [row[np.isfinite(row)] for row in seconds]
    content = encode(table)
    timings = pa.table(
        {"trial": np.array(trials), "replan_seconds": made},
        schema=pa.schema(TIMING_FIELDS, metadata={DIGEST_KEY: digest_of(content)}),
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


def _read(folder: Folder, of: MonteCarlo, loop: Loop, trials: int) -> pa.Table:
    """The first so many trials of a loop, with what their plans took."""
    portions = list(_portions(of, loop, trials))
    rows = pa.concat_tables([read_shard(folder, one.path) for one in portions])
    taken = pa.concat_tables([read_shard(folder, one.timings) for one in portions])
    return rows.append_column("replan_seconds", taken["replan_seconds"]).slice(0, trials)
