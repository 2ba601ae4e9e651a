"""The parts of an experiment: independent tables made by workers, kept until all are done."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

import pandas as pd

from pipeline.errors import InputError
from pipeline.parallel.workers import Workers, check_worker
from pipeline.progress import Progress
from pipeline.provenance import DecidedBy, made_with
from pipeline.storage.folder import Folder
from pipeline.storage.ledger import Ledger, NewShard, listed_shards, open_ledger, sole_writer
from pipeline.storage.shards import table_bytes, table_from

SCHEMA = "prolearn.parts/1"
OWNED = r"table=\w+/part-\d{5,}\.parquet"  # pattern of the names of shards

Argument = TypeVar("Argument")


@dataclass(frozen=True, eq=False)
class Part(Generic[Argument]):
    """A part of an experiment: a worker makes a table from its argument."""

    argument: Argument
    n: int  # spacecraft of its swarms
    note: str = ""  # for progress, when it is done


@dataclass(frozen=True)
class FinishedParts:
    """Finished parts of one experiment in a folder."""

    ledger: Ledger
    decided_by: DecidedBy  # code that decides the tables: workers must have the same versions

    def read(self, name: str) -> pd.DataFrame | None:
        """The table of a part; None where it is not there, or not as it was written."""
        if not self.ledger.is_sound(name):
            return None
        try:
            return table_from(self.ledger.folder.read(name))
        except (OSError, InputError):
            return None

    def write(self, name: str, table: pd.DataFrame) -> None:
        """Keep the table of a finished part."""
        self.ledger.publish(NewShard(name, table_bytes(table)))
        self.ledger.commit()  # now, since the next part may take an hour


@contextmanager
def open_parts(
    folder: Folder, decided_by: DecidedBy, *, resume: bool, progress: Progress
) -> Iterator[FinishedParts]:
    """Open a folder of finished parts of an experiment, locked for the block.

    With ``resume`` parts of an earlier run are used, else removed. InputError where another process
    holds the folder.
    """
    with sole_writer(folder, OWNED):
        for name in () if resume else folder.names():
            if name.endswith(".parquet"):
                folder.remove(name)
        fields = {"schema": SCHEMA, "shards": listed_shards(folder, SCHEMA) if resume else {}}
        with open_ledger(folder, fields, progress) as ledger:
            yield FinishedParts(ledger, decided_by)


def finish_parts(
    name: str,
    make: Callable[[Argument], pd.DataFrame],
    parts: Sequence[Part[Argument]],
    *,
    workers: Workers,
    kept: FinishedParts | None,
) -> list[pd.DataFrame]:
    """The table of each part, read if kept and else made.

    The name tells these parts from others of the same experiment.
    """
    paths = [f"table={name}/part-{number:05d}.parquet" for number in range(len(parts))]
    tables = [kept.read(path) if kept else None for path in paths]
    tasks = [(k, parts[k]) for k, table in enumerate(tables) if table is None]
    # Large swarms take longest: begun last, one would keep a worker when the others are done.
    tasks.sort(key=lambda task: -task[1].n)
    workers.progress.expect(len(parts))
    if len(tasks) < len(parts):
        workers.progress.done(len(parts) - len(tasks), "kept")
    decided_by = kept.decided_by if kept else ((), ())
    make_part = partial(_make_part, make, decided_by, made_with(*decided_by))
    with closing(workers.work(make_part, tasks, lambda _: b"")) as results:
        for (number, part), table in results:
            if kept:
                kept.write(paths[number], table)
            tables[number] = table
            workers.progress.done(note=part.note)
    return [table for table in tables if table is not None]


def _make_part(
    make: Callable[[Argument], pd.DataFrame],
    decided_by: DecidedBy,
    expected: Mapping[str, str],
    task: tuple[int, Part[Argument]],
    _: bytes,
) -> pd.DataFrame:
    check_worker(expected, decided_by)
    return make(task[1].argument)
