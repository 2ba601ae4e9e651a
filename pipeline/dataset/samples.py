"""How scenarios are sampled into splits and shards, and the samples of the preset datasets."""

from dataclasses import dataclass
from itertools import pairwise

from pipeline.errors import InputError, check_choice, check_range
from pipeline.scenario import FAMILIES, SPLITS
from pipeline.scenario.families import SEEDS


@dataclass(frozen=True)
class Sample:
    """How the scenarios of one swarm size are drawn."""

    family: str = "rings"
    seed: int = 0  # root seed
    count: int = 1000  # number of scenarios
    shares: tuple[float, float, float] = (0.8, 0.1, 0.1)  # of train, valid and test, in this order
    shard_rows: int = 250  # scenarios in a shard

    def __post_init__(self) -> None:
        check_choice("family", self.family, FAMILIES)
        check_range("count", self.count, 1, SEEDS - 1)
        check_range("seed", self.seed, 0, SEEDS - 1)
        check_range("the number of rows in a shard", self.shard_rows, 1, SEEDS - 1)
        if not (min(self.shares) >= 0 and abs(sum(self.shares) - 1) <= 1e-9):  # NaN fails both
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
        """Row range of each split; the last with a share above 0 gets the rounding remainder."""
        train, valid = (round(self.count * share) for share in self.shares[:2])
        if self.shares[2] == 0:
            valid = self.count - train
        ends = (0, train, min(train + valid, self.count), self.count)
        return {split: range(*rows) for split, rows in zip(SPLITS, pairwise(ends), strict=True)}

    def drawn_as(self, rows: range) -> list[tuple[str, int]]:
        """The split of each row's scenario, and its index there."""
        return [
            (split, row - span.start)
            for split, span in self.splits.items()
            for row in range(max(span.start, rows.start), min(span.stop, rows.stop))
        ]

    def rows(self, shard: int) -> range:
        """The rows of a shard, counted over the whole sample."""
        first = shard * self.shard_rows
        return range(first, min(first + self.shard_rows, self.count))

    def splits_of(self, shard: int) -> set[str]:
        """The splits that a shard has rows of."""
        rows, splits = self.rows(shard), self.splits.items()
        return {k for k, s in splits if max(s.start, rows.start) < min(s.stop, rows.stop)}


ONLY_TEST = (0.0, 0.0, 1.0)

PRESETS: dict[str, dict[int, Sample]] = {
    "demo": {
        **{n: Sample(count=20, shares=ONLY_TEST, shard_rows=10) for n in (2, 5, 15, 20, 30)},
        60: Sample(count=10, shares=ONLY_TEST, shard_rows=5),
        10: Sample(count=1250, shares=(0.8, 0.12, 0.08), shard_rows=125),
    },
    "paper": {
        **{n: Sample(count=100, shares=ONLY_TEST, shard_rows=25) for n in range(2, 31)},
        10: Sample(count=10_000, shares=(0.8, 0.1, 0.1), shard_rows=250),
        60: Sample(count=50, shares=ONLY_TEST, shard_rows=10),
        100: Sample(count=50, shares=ONLY_TEST, shard_rows=10),
        300: Sample(count=10, shares=ONLY_TEST, shard_rows=2),
    },
}
"""The datasets that the experiments need, by name and swarm size.

``paper`` is 8000 + 1000 + 1000 at n = 10, which the paper trains on, 100 trials of experiment 2 at
every other n up to 30, and swarms beyond the paper's, whose rings grow with n so that craft stay
as dense as at n = 30.
"""
