"""The manifest of a dataset folder: what it is meant to hold, and the digest of every shard.

    FOLDER/n=10/part-00000.parquet                solved instances
    FOLDER/_scenarios/n=10/part-00000.parquet     the scenarios they come from
    FOLDER/_timings/n=10/part-00000.parquet       how long each took
    FOLDER/_manifest.json                         this

Readers of Parquet folders pass over names that begin with an underscore.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from pipeline.dataset.storage.folder import Folder, Where, open_folder
from pipeline.dataset.storage.schema import SCHEMA, metadata
from pipeline.errors import InputError
from pipeline.orbit.problem import Problem
from pipeline.scenario import SPLITS
from pipeline.scenario.families import SEEDS

NAME = "_manifest.json"
SCENARIOS, TIMINGS = "_scenarios/", "_timings/"


@dataclass(frozen=True)
class Sample:
    """How the scenarios of one swarm size are drawn.

    Attributes:
        family: family of scenarios.
        seed: root seed.
        count: how many.
        shares: shares of train, valid and test, whose rows follow each other in this order.
        shard_rows: instances in a shard.
    """

    family: str = "rings"
    seed: int = 0
    count: int = 1000
    shares: tuple[float, float, float] = (0.8, 0.1, 0.1)
    shard_rows: int = 250

    def __post_init__(self) -> None:
        """Refuse what cannot be sampled."""
        if self.count < 1:
            raise InputError(f"count is {self.count}; expected at least one scenario.")
        if not 0 <= self.seed < SEEDS:
            raise InputError(f"seed is {self.seed}; expected 0 to {SEEDS - 1}.")
        if self.shard_rows < 1:
            raise InputError(f"shard_rows is {self.shard_rows}; expected at least 1.")
        if min(self.shares) < 0 or abs(sum(self.shares) - 1) > 1e-9:
            raise InputError(
                f"the shares of {', '.join(SPLITS)} are {self.shares}; expected three numbers "
                "of 0 or more that add up to 1."
            )

    @property
    def shards(self) -> int:
        """Number of shards."""
        return -(-self.count // self.shard_rows)

    def rows_of(self, split: str) -> range:
        """The rows of a split."""
        train, valid = (round(self.count * share) for share in self.shares[:2])
        ends = (0, train, min(train + valid, self.count), self.count)
        k = SPLITS.index(split)
        return range(ends[k], ends[k + 1])

    def drawn_as(self, row: int) -> tuple[str, int]:
        """The split of a row's scenario, and its index there."""
        for split in SPLITS:
            rows = self.rows_of(split)
            if row in rows:
                return split, row - rows.start
        raise ValueError(f"row {row} of {self.count}")

    def splits_of(self, shard: int) -> set[str]:
        """The splits that a shard has rows of."""
        rows = self.rows(shard)
        first, last = (SPLITS.index(self.drawn_as(row)[0]) for row in (rows[0], rows[-1]))
        return {split for split in SPLITS[first : last + 1] if self.rows_of(split)}

    def origin(self) -> dict[str, Any]:
        """What the metadata of shards says about where their scenarios come from."""
        return {"seed": self.seed, "family": self.family}

    def rows(self, shard: int) -> range:
        """The rows of a shard, counted over the whole sample."""
        first = shard * self.shard_rows
        return range(first, min(first + self.shard_rows, self.count))


@dataclass(frozen=True)
class Manifest:
    """What a dataset folder is meant to hold and what of it is there.

    Attributes:
        problem: the problem that all its instances share.
        samples: how each swarm size is drawn.
        solve: settings of the expert, or nothing before the first solve.
        sampled_with: versions that the scenarios were drawn with.
        solved_with: versions that they are solved with, or nothing before the first solve.
        shards: SHA-256 digest of each finished shard, by path inside the folder.
    """

    problem: Problem
    samples: Mapping[int, Sample] = field(default_factory=dict)
    solve: Mapping[str, Any] = field(default_factory=dict)
    sampled_with: Mapping[str, str] = field(default_factory=dict)
    solved_with: Mapping[str, str] = field(default_factory=dict)
    shards: Mapping[str, str] = field(default_factory=dict)

    def scenario_shards(self) -> list[tuple[int, int, str]]:
        """Swarm size, shard number and path of every scenario shard."""
        return [
            (n, k, SCENARIOS + shard_name(n, k))
            for n, sample in sorted(self.samples.items())
            for k in range(sample.shards)
        ]

    def solved_shards(self) -> dict[str, str]:
        """Path of every solved shard, and of the scenario shard that it comes from."""
        return {shard_name(n, k): path for n, k, path in self.scenario_shards()}

    def scenario_metadata(self, n: int) -> dict[bytes, bytes]:
        """The schema metadata of the scenario shards of a swarm size."""
        return metadata(self.problem, self.samples[n].origin(), self.sampled_with)

    def solved_metadata(self, n: int) -> dict[bytes, bytes]:
        """The schema metadata of the solved shards of a swarm size."""
        settings = self.samples[n].origin() | dict(self.solve)
        return metadata(self.problem, settings, self.solved_with)

    def digest(self, n: int | None = None) -> str:
        """Digest of the solved data, or of one swarm size: the same bytes, the same digest."""
        top = "n=" if n is None else f"n={n}/"
        solved = {p: d for p, d in self.shards.items() if p.startswith(top)}
        return hashlib.sha256(json.dumps(solved, sort_keys=True).encode()).hexdigest()


def shard_name(n: int, shard: int) -> str:
    """Path of a solved shard inside the folder."""
    return f"n={n}/part-{shard:05d}.parquet"


def read_manifest(where: Where | Folder) -> Manifest:
    """The manifest of a dataset.

    Raises:
        InputError: where the folder is missing, empty or holds no dataset.
    """
    folder = open_folder(where)
    if not folder.exists(NAME):
        what = "does not exist"
        if folder.is_there():
            what = "holds no dataset" if folder.names() else "is empty"
        raise InputError(
            f"{folder} {what}; expected a dataset folder: make one with "
            f"`prolearn dataset --preset demo --out {folder}`."
        )
    try:
        document = json.loads(folder.read(NAME))
        if document["schema"] != SCHEMA:
            raise InputError(
                f"{folder} has schema {document['schema']}, of another version of prolearn; "
                f"expected {SCHEMA}: make the dataset anew in another folder, or remove this one."
            )
        samples = {
            int(n): Sample(**{**s, "shares": tuple(s["shares"])})
            for n, s in document["samples"].items()
        }
        problem = Problem(**document["problem"])
        made = document["made_with"]
        return Manifest(
            problem, samples, document["solve"], made["sample"], made["solve"], document["shards"]
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{NAME} in {folder} is damaged ({error!r}); delete it and give the command that made "
            "the dataset again: shards that are sound are kept."
        ) from error


def write_manifest(folder: Folder, manifest: Manifest) -> None:
    """Write the manifest, whole."""
    document = {
        "schema": SCHEMA,
        "problem": asdict(manifest.problem),
        "samples": {str(n): asdict(s) for n, s in sorted(manifest.samples.items())},
        "solve": dict(manifest.solve),
        "made_with": {"sample": dict(manifest.sampled_with), "solve": dict(manifest.solved_with)},
        "shards": dict(sorted(manifest.shards.items())),
    }
    folder.publish(NAME, (json.dumps(document, indent=1) + "\n").encode())


def refuse_change(what: str, was: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Refuse to go on with other settings than a folder was begun with.

    Raises:
        InputError: naming the first setting that differs, what it was and what it is now.
    """
    for name in sorted({*was, *now}):
        if was.get(name) != now.get(name):
            raise InputError(
                f"{what} was begun with {name} = {was.get(name)}, now it is {now.get(name)}; "
                "expected the same settings: give the old one or another folder."
            )
