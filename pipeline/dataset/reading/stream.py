"""Examples that are read shard by shard, for datasets larger than memory."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import pyarrow as pa
import pyarrow.compute as pc

from pipeline.dataset.format.manifest import Manifest, Shard, read_manifest
from pipeline.dataset.reading.examples import Examples, ExampleSource
from pipeline.dataset.reading.read import LEARNED, examples, examples_of, no_examples, shards_of
from pipeline.dataset.reading.shards import solved_table
from pipeline.errors import check_range
from pipeline.orbit.problem import Problem
from pipeline.plan import SOLVED
from pipeline.storage.folder import Folder, Where, open_folder

TOLD = ("split", "status")
"""Columns that say whether a row is an example."""

MEMORY = 2e9
"""Bytes that training may take for its data by default."""

COPIES = 8
"""How often examples are in memory while they are read and encoded, at the worst."""


@dataclass(frozen=True)
class ExampleStream:
    """Solved instances of a split that stay on disk; each pass reads them anew.

    Attributes:
        folder: a solved dataset.
        manifest: what it holds.
        n: number of spacecraft in each instance.
        split: "train", "valid" or "test".
        shards: those that hold them.
        count: number of instances.
        buffer: instances that may be held at once, beside the shard that is being read.
    """

    folder: Folder
    manifest: Manifest
    n: int
    split: str
    shards: tuple[Shard, ...]
    count: int
    buffer: int

    def __len__(self) -> int:
        """Number of instances."""
        return self.count

    @property
    def problem(self) -> Problem:
        """The problem that they share."""
        return self.manifest.problem

    @property
    def part_count(self) -> int:
        """A shard is a part."""
        return len(self.shards)

    def parts(self, order: Sequence[int] | None = None) -> Iterator[Examples]:
        """The instances of one shard after another, in an order of the shards."""
        for k in range(len(self.shards)) if order is None else order:
            wanted = [*LEARNED, *TOLD]
            table = solved_table(self.folder, self.manifest, self.shards[k], wanted)
            yield examples_of(table.filter(pc.equal(table["split"], self.split)), self.n)


def examples_within(
    where: Where | Folder, n: int, split: str, memory: float = MEMORY
) -> ExampleSource:
    """Solved instances of a split: loaded once where they fit into memory, else streamed.

    Args:
        where: a solved dataset; instances that are not solved are left out.
        n: swarm size.
        split: "train", "valid" or "test".
        memory: bytes that they may take, encoded and all.

    Raises:
        InputError: where there is no dataset, the size is not in it, it is not solved, a shard is
            damaged, no instance of the split is solved, or memory is not a positive number.
    """
    check_range("memory", memory, 1, 1e15)
    folder = open_folder(where)
    manifest = read_manifest(folder)
    shards = tuple(shards_of(folder, manifest, n, split))
    count = sum(_solved_count(solved_table(folder, manifest, one, TOLD), split) for one in shards)
    if count == 0:
        raise no_examples(where, n, split)
    buffer = max(1, int(memory / (COPIES * bytes_of_one(n, manifest.problem))))
    if count <= buffer:
        return examples(folder, n, split)
    return ExampleStream(folder, manifest, n, split, shards, count, buffer)


def bytes_of_one(n: int, problem: Problem) -> int:
    """Size of an instance's arrays."""
    return 8 * n * 6 * (2 + problem.nodes)


def _solved_count(table: pa.Table, split: str) -> int:
    wanted = pc.and_(pc.equal(table["split"], split), pc.equal(table["status"], SOLVED))
    return int(pc.sum(wanted).as_py() or 0)
