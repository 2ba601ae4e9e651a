"""Solved datasets read back: scenarios for the experiments, arrays for training."""

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from pipeline.dataset.examples import Examples
from pipeline.dataset.manifest import read_manifest, shard_name
from pipeline.dataset.schema import problem_of, stacked
from pipeline.dataset.shards import read_shard
from pipeline.errors import InputError
from pipeline.plan import SOLVED


def solved_rows(
    folder: Path, n: int, split: str | None = None, columns: Sequence[str] | None = None
) -> pa.Table:
    """Rows of one swarm size, in order of their index.

    Args:
        folder: a solved dataset.
        n: swarm size.
        split: "train", "valid" or "test", or all.
        columns: columns to read besides ``split`` and ``status``, or all.

    Raises:
        InputError: where there is no dataset, the size is not in it, or it is not solved.
    """
    manifest = read_manifest(folder)
    if n not in manifest.samples:
        sizes = ", ".join(str(size) for size in sorted(manifest.samples))
        raise InputError(f"{folder} has no scenarios of n={n}; expected n in {sizes}.")
    files = [folder / shard_name(n, k) for k in range(manifest.samples[n].shards)]
    if not all(file.exists() for file in files):
        raise InputError(f"{folder} is not solved at n={n}; run `prolearn solve {folder}` first.")
    wanted = None if columns is None else list({"split", "status", *columns})
    table = pa.concat_tables([read_shard(file, wanted) for file in files])
    return table if split is None else table.filter(pc.equal(table["split"], split))


def examples(folder: Path, n: int, split: str) -> Examples:
    """Solved instances of a split as arrays; the others are left out.

    Raises:
        InputError: as in ``solved_rows``, or where no instance of the split is solved.
    """
    table = solved_rows(folder, n, split, ("initial", "goal", "states"))
    table = table.filter(pc.equal(table["status"], SOLVED))
    if table.num_rows == 0:
        raise InputError(
            f"{folder} has no solved instance of n={n} in its {split} split; expected some: "
            "sample more scenarios."
        )
    problem = problem_of(table.schema)
    return Examples(
        problem=problem,
        initial=stacked(table, "initial", n, 6),
        goal=stacked(table, "goal", n, 6),
        states=stacked(table, "states", n, problem.nodes, 6),
    )
