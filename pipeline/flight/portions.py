"""What a Monte Carlo flies, in portions, and what decides the bytes of their shards."""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.flight.errors import Errors
from pipeline.flight.world import World
from pipeline.orbit.approaches import MOST_PAIRS
from pipeline.planners.planner import Planner, identity
from pipeline.provenance import DecidedBy, made_with
from pipeline.scenario import Scenario
from pipeline.scenario.families import SEEDS
from pipeline.storage.layout import TIMINGS
from pipeline.storage.shards import (
    Size,
    metadata_of,
)

SCHEMA = "prolearn.flight/2"

OWNED = rf"({TIMINGS})?loop=[\w-]+/part-\d{{5,}}\.parquet"
"""Pattern of the names of shards."""

PORTION = 50
"""Most trials that are flown side by side, and rows of a shard."""

MADE_BY: DecidedBy = (
    tuple(
        f"pipeline/{part}"
        for part in ("orbit", "scenario", "plan", "expert", "networks", "planners", "flight")
    ),
    ("numpy", "scipy", "numba", "pyarrow", "clarabel", "highspy", "torch"),
)
"""Code of ours and packages that the bytes of trials depend on."""


@dataclass(frozen=True)
class Manifest:
    """The manifest of a Monte Carlo.

    Attributes:
        shards: SHA-256 digest of each finished shard, by path inside the folder.
    """

    shards: Mapping[str, str]

    def fields(self) -> dict[str, Any]:
        """What its file has, JSON-ready."""
        return {"schema": SCHEMA, "shards": dict(sorted(self.shards.items()))}


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
            "planner": None if loop.planner is None else identity(loop.planner),
            "margin": loop.margin,
        }


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
    def metadata(self) -> dict[bytes, bytes]:
        """The schema metadata of its shard."""
        of = self.of
        return metadata_of(
            {**of.settings(self.loop), "part": self.number, "made_with": dict(of.made_with)}
        )

    @property
    def most(self) -> Size:
        """What its files may hold."""
        return Size(self.of.portion, self.of.portion * self.of.scenario.problem.intervals)


def portion_of(n: int) -> int:
    """Trials of n craft that are flown side by side: so few that their pairs fit in memory."""
    return max(1, min(PORTION, 2 * MOST_PAIRS // n**2))
