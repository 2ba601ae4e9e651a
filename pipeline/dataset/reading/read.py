"""Solved datasets read back: scenarios for the experiments, arrays for training."""

from collections.abc import Sequence

import pyarrow as pa
import pyarrow.compute as pc

from pipeline.dataset.format.manifest import Manifest, Shard, read_manifest
from pipeline.dataset.format.schema import problem_of, stacked
from pipeline.dataset.reading.examples import Examples
from pipeline.dataset.reading.shards import refuse_unsolved, solved_table
from pipeline.errors import InputError
from pipeline.plan import SOLVED
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.urls import public_url

LEARNED = ("initial", "goal", "states")
"""Columns that training reads."""


def shards_of(folder: Folder, manifest: Manifest, n: int, split: str | None = None) -> list[Shard]:
    """The shards of one swarm size that hold rows of a split, in order.

    Raises:
        InputError: where the size is not in the dataset, or not solved.
    """
    if n not in manifest.samples:
        sizes = ", ".join(str(size) for size in sorted(manifest.samples))
        raise InputError(f"{folder} has no scenarios of n={n}; expected n in {sizes}.")
    every = [shard for shard in manifest.expected() if shard.n == n]
    refuse_unsolved(folder, manifest, every)
    return [s for s in every if split is None or split in s.sample.splits_of(s.number)]


def solved_rows(
    where: Where | Folder, n: int, split: str | None = None, columns: Sequence[str] | None = None
) -> pa.Table:
    """Rows of one swarm size, in order of their index.

    Args:
        where: a solved dataset.
        n: swarm size.
        split: "train", "valid" or "test", or all.
        columns: columns to read besides ``split`` and ``status``, or all.

    Raises:
        InputError: where there is no dataset, the size is not in it, it is not solved, or a
            shard is damaged.
    """
    folder = open_folder(where)
    manifest = read_manifest(folder)
    wanted = None if columns is None else list({"split", "status", *columns})
    # At least a schema, where no shard has rows of the split.
    shards = shards_of(folder, manifest, n, split) or shards_of(folder, manifest, n)[:1]
    table = pa.concat_tables([solved_table(folder, manifest, one, wanted) for one in shards])
    return table if split is None else table.filter(pc.equal(table["split"], split))


def examples(where: Where | Folder, n: int, split: str) -> Examples:
    """Solved instances of a split as arrays; the others are left out.

    Raises:
        InputError: as in ``solved_rows``, or where no instance of the split is solved.
    """
    found = examples_of(solved_rows(where, n, split, LEARNED), n)
    if len(found) == 0:
        raise no_examples(where, n, split)
    return found


def examples_of(table: pa.Table, n: int) -> Examples:
    """The solved rows of a table as arrays, without a loop over rows."""
    table = table.filter(pc.equal(table["status"], SOLVED))
    problem = problem_of(table)
    return Examples(
        problem=problem,
        initial=stacked(table, "initial", n, 6),
        goal=stacked(table, "goal", n, 6),
        states=stacked(table, "states", n, problem.nodes, 6),
    )


def no_examples(where: Where | Folder, n: int, split: str) -> InputError:
    """The refusal of a split with nothing to learn from."""
    return InputError(
        f"{public_url(where)} has no solved instance of n={n} in its {split} split; expected "
        "some: sample more scenarios."
    )
