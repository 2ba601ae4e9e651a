"""The table of an experiment's run, checked against its columns, and its averages."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd
from pandas.api.types import infer_dtype

from pipeline.experiments.ablations import summarize_ablations
from pipeline.experiments.averages import summarize
from pipeline.experiments.experiment3 import summarize_warmstarts
from pipeline.experiments.experiment4 import summarize_times
from pipeline.experiments.experiment5 import summarize_flights
from pipeline.experiments.records import TABLES
from registry.results import Run, experiment_run
from registry.run_files import TABLE, table_of, unusable
from registry.store import ABLATIONS, EVALUATION, FLIGHTS, TRANSFER_TIMES, WARMSTART


@dataclass(frozen=True)
class Kind:
    """The table that runs of an experiment have.

    Attributes:
        name: in ``TABLES``, which has its columns, and in a report's ``Results``.
        averages: how its trials are averaged.
    """

    name: str
    averages: Callable[[pd.DataFrame], pd.DataFrame]


KINDS: Mapping[str, Kind] = {
    EVALUATION: Kind("trials", summarize),
    WARMSTART: Kind("warmstarts", summarize_warmstarts),
    TRANSFER_TIMES: Kind("transfer_times", summarize_times),
    FLIGHTS: Kind("flights", summarize_flights),
    ABLATIONS: Kind("ablations", summarize_ablations),
}
"""By the experiment's name in MLflow."""

FITTING = {
    str: ("text", {"string"}),
    int: ("whole numbers", {"integer"}),
    float: ("numbers", {"floating", "integer", "mixed-integer-float"}),
    bool: ("true or false", {"boolean"}),
}
"""What columns of a type hold, in words and as pandas calls it."""

WITHOUT_GAPS = (str, int)
"""Types of which no value may be missing."""


def sound_table(run: Run) -> pd.DataFrame:
    """A run's table: a row for each trial.

    Raises:
        InputError: where its file is damaged, or is not a table that its experiment leaves.
        ProlearnError: where it cannot be fetched.
    """
    table = table_of(run)
    if table.empty:
        raise unusable(run, TABLE, "it has no rows")
    for name, kind in TABLES[KINDS[run.experiment].name].items():
        if name not in table:
            raise unusable(run, TABLE, f"it has no column {name}")
        words, fitting = FITTING[kind]
        gaps = kind in WITHOUT_GAPS and table[name].hasnans
        if gaps or infer_dtype(table[name], skipna=True) not in fitting:
            raise unusable(run, TABLE, f"its column {name} does not hold {words} in every row")
    return table


def averages(run_id: str) -> list[dict[str, Any]]:
    """The averages of an experiment's run, as in the report: a row each planner and setting.

    Raises:
        InputError: where its table is damaged.
    """
    run = experiment_run(run_id)
    trials = sound_table(run)
    try:
        rows = KINDS[run.experiment].averages(trials)
    except Exception as error:  # of any kind: anyone may have written any values
        raise unusable(run, TABLE, f"its values have no averages: {error!r}") from error
    plain = rows.astype(object).where(rows.notna(), None)  # no number of pandas' own kinds
    return [dict(zip(rows.columns, row, strict=True)) for row in plain.itertuples(index=False)]
