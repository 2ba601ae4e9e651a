"""Reading of solved datasets: rows for the experiments, arrays for training, perhaps streamed."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

import pyarrow as pa
import pyarrow.compute as pc

from pipeline.dataset.examples import Examples, ExampleSource, ExampleStream
from pipeline.dataset.manifest import Manifest, Shard, read_manifest
from pipeline.dataset.schema import SCENARIO_FIELDS, problem_of, scenarios_of, stacked
from pipeline.errors import InputError, check_range
from pipeline.orbit.problem import Problem
from pipeline.plan.plan import SOLVED
from pipeline.scenario import Scenario
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.shards import decode, has_metadata, read_verified
from pipeline.text import as_argument, public_url

TRAINING_COLUMNS = ("initial", "goal", "states")  # columns that training reads
SELECTION_COLUMNS = ("split", "status")  # columns that decide whether a row is an example
MEMORY = 2e9  # bytes that training may take for its data by default
COPIES = 8  # most copies of examples in memory while they are read and encoded


def refuse_unsolved(folder: Folder, shards: Iterable[Shard]) -> None:
    """Raise InputError, naming the first shard that is not solved yet."""
    for shard in shards:
        if not shard.digest:
            raise InputError(
                f"{folder} is not solved at n={shard.n} ({shard.solved}); run "
                f"`prolearn solve {as_argument(folder)}` first."
            )


def without_rows(where: Where | Folder, what: str) -> InputError:
    """The error for a dataset that has none of the rows that are asked for."""
    return InputError(
        f"{public_url(where)} has no {what}; expected some: sample more scenarios, into another "
        "folder."
    )


def read_solved(
    folder: Folder, shard: Shard, columns: Sequence[str] | None = None, *, trusted: bool = False
) -> pa.Table:
    """The rows of a solved shard, or some of their columns; InputError where it is damaged.

    ``trusted`` says that it was read and checked before, with the same digest.
    """
    with shard_named(shard, str(folder)):
        content = read_verified(folder, shard.solved, shard.digest)
        return decode_solved(content, shard, columns, trusted=trusted)


def decode_solved(
    content: bytes, shard: Shard, columns: Sequence[str] | None = None, *, trusted: bool = False
) -> pa.Table:
    """The rows of a solved shard from its bytes; InputErrors do not name the shard."""
    table = decode(content, shard.most, columns, trusted=trusted)
    if not has_metadata(table, shard.metadata(shard.solved)):
        raise InputError("was made with other settings than the manifest has")
    return table


@contextmanager
def shard_named(shard: Shard, folder: str) -> Iterator[None]:
    """Add the name of the shard, and how to repair it, to InputErrors in the block."""
    try:
        yield
    except InputError as error:
        raise InputError(
            f"{shard.solved} in {folder} {error}; mend the dataset with `prolearn verify "
            f"{as_argument(folder)} --repair`."
        ) from error


def solved_rows(
    where: Where | Folder, n: int, split: str | None = None, columns: Sequence[str] | None = None
) -> pa.Table:
    """Rows of one swarm size, of one split or all, in order of their index.

    All columns are read, or those given, ``split`` and ``status``. InputError for what is not in
    the dataset, not solved or damaged.
    """
    folder = open_folder(where)
    manifest = read_manifest(folder)
    wanted = None if columns is None else list({*SELECTION_COLUMNS, *columns})
    # At least a schema, where no shard has rows of the split.
    shards = _shards(folder, manifest, n, split) or _shards(folder, manifest, n)[:1]
    table = pa.concat_tables([read_solved(folder, shard, wanted) for shard in shards])
    return table if split is None else table.filter(pc.field("split") == split)


def solved_scenarios(where: Where | Folder, n: int, split: str) -> list[Scenario]:
    """Scenarios of one swarm size and split in order of their index; errors as ``solved_rows``."""
    return scenarios_of(solved_rows(where, n, split, [field.name for field in SCENARIO_FIELDS]))


def solved_examples(
    where: Where | Folder, n: int, split: str, memory: float = MEMORY
) -> ExampleSource:
    """Solved instances of a split: loaded where they fit into ``memory`` bytes, else streamed.

    InputErrors as of ``solved_rows``, and where none is solved.
    """
    check_range("memory", memory, 1, 1e15)
    folder = open_folder(where)
    manifest = read_manifest(folder)
    shards = _shards(folder, manifest, n, split)
    tables = (read_solved(folder, shard, SELECTION_COLUMNS) for shard in shards)
    count = sum(len(_solved_of_split(table, split)) for table in tables)
    if count == 0:
        raise without_rows(folder, f"solved instance of n={n} in its {split} split")
    buffer = buffer_size(memory, n, manifest.problem)
    if count <= buffer:
        return _examples(solved_rows(folder, n, split, TRAINING_COLUMNS), n, split)

    def read(part: int) -> Examples:
        columns = [*TRAINING_COLUMNS, *SELECTION_COLUMNS]
        return _examples(read_solved(folder, shards[part], columns, trusted=True), n, split)

    return ExampleStream(manifest.problem, n, count, buffer, len(shards), read)


def buffer_size(memory: float, n: int, problem: Problem) -> int:
    """Size of the shuffle buffer, in instances of n craft, for a limit of memory in bytes."""
    instance = 8 * n * 6 * (2 + problem.nodes)  # bytes of its arrays
    return max(1, int(memory / (COPIES * instance)))


def _shards(folder: Folder, manifest: Manifest, n: int, split: str | None = None) -> list[Shard]:
    """The solved shards of one swarm size that hold rows of a split, in order."""
    if n not in manifest.samples:
        sizes = ", ".join(str(size) for size in sorted(manifest.samples))
        relation = "in" if len(manifest.samples) > 1 else "="
        raise InputError(f"{folder} has no scenarios of n={n}; expected n {relation} {sizes}.")
    shards = [shard for shard in manifest.expected() if shard.n == n]
    refuse_unsolved(folder, shards)
    return [s for s in shards if split is None or split in s.sample.splits_of(s.number)]


def _solved_of_split(table: pa.Table, split: str) -> pa.Table:
    """The solved rows of a split; the table itself, uncopied, where these are all of its rows."""
    fits = pc.and_(pc.equal(table["split"], split), pc.equal(table["status"], SOLVED))
    return table if pc.all(fits).as_py() else table.filter(fits)


def _examples(table: pa.Table, n: int, split: str) -> Examples:
    table = _solved_of_split(table, split)
    problem = problem_of(table)
    ends = stacked(table, "initial", n, 6), stacked(table, "goal", n, 6)
    return Examples(problem, *ends, stacked(table, "states", n, problem.nodes, 6))
