"""How scenarios are drawn, and which rows of a sample are of which split and in which shard."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from pipeline.errors import InputError
from pipeline.scenario import SPLITS
from pipeline.scenario.families import SEEDS, check_family


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
        check_family(self.family)
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

    @property
    def splits(self) -> dict[str, range]:
        """The rows of each split."""
        train, valid = (round(self.count * share) for share in self.shares[:2])
        ends = (0, train, min(train + valid, self.count), self.count)
        return {split: range(*rows) for split, rows in zip(SPLITS, pairwise(ends), strict=True)}

    def drawn_as(self, row: int) -> tuple[str, int]:
        """The split of a row's scenario, and its index there."""
        return next((name, row - of.start) for name, of in self.splits.items() if row in of)

    def splits_of(self, shard: int) -> set[str]:
        """The splits that a shard has rows of."""
        rows = self.rows(shard)
        return {
            name
            for name, of in self.splits.items()
            if max(of.start, rows.start) < min(of.stop, rows.stop)
        }

    def origin(self) -> dict[str, Any]:
        """What the metadata of shards says about where their scenarios come from."""
        return {"seed": self.seed, "family": self.family}

    def rows(self, shard: int) -> range:
        """The rows of a shard, counted over the whole sample."""
        first = shard * self.shard_rows
        return range(first, min(first + self.shard_rows, self.count))
