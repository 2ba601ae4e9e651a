"""What a report is made from: result tables, example transfers and facts about the run."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import pandas as pd

from pipeline.errors import InputError
from pipeline.experiments.records import NO_SEED, TABLES
from pipeline.figures.labels import planner_of
from pipeline.figures.transfer import Example


def no_rows(table: str) -> pd.DataFrame:
    """A table of ``TABLES`` without rows."""
    return pd.DataFrame(columns=list(TABLES[table]))


@dataclass(frozen=True, eq=False)
class Results:
    """Tables as the experiments leave them, by their columns in TABLES; most may be empty.

    Attributes:
        provenance: a row for each run that a table comes from: part, run, made, data, digest,
            code, versions, machine.
        notes: on parts that are left out or were made otherwise; text, or ``Markdown``.

    Raises:
        InputError: ``trials`` is empty, or a table lacks a column of ``TABLES``.
    """

    trials: pd.DataFrame
    warmstarts: pd.DataFrame = field(default_factory=partial(no_rows, "warmstarts"))
    training: pd.DataFrame = field(default_factory=partial(no_rows, "training"))
    curves: pd.DataFrame = field(default_factory=partial(no_rows, "curves"))
    examples: Sequence[Example] = ()
    provenance: pd.DataFrame = field(default_factory=pd.DataFrame)
    notes: Sequence[str] = ()
    transfer_times: pd.DataFrame = field(default_factory=partial(no_rows, "transfer_times"))
    flights: pd.DataFrame = field(default_factory=partial(no_rows, "flights"))

    def __post_init__(self) -> None:
        if self.trials.empty:
            raise InputError(
                "the results hold no trials, and a report needs at least one planner's: "
                "run `prolearn evaluate` first"
            )
        for name, columns in TABLES.items():
            missing = [c for c in columns if c not in getattr(self, name).columns]
            if missing:
                raise InputError(
                    f"the results table {name!r} lacks the columns {', '.join(missing)}: "
                    "write it with the prolearn of this report"
                )

    @property
    def planners(self) -> set[str]:
        """Every planner that some table names."""
        tables = (self.trials, self.transfer_times, self.flights)
        named = [table["planner"] for table in tables]
        named += [self.training["arch"], self.curves["arch"]]
        return {*pd.concat(named), *map(planner_of, self.warmstarts["seed"])} - {NO_SEED}
