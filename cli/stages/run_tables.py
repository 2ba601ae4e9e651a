"""The table of a run, with the columns that tables of its experiment have."""

from collections.abc import Mapping

import pandas as pd
from pandas.api.types import infer_dtype

from pipeline.experiments.records import TABLES
from registry.artifacts import TABLE, unusable
from registry.results import table_of
from registry.runs import Run
from registry.store import ABLATIONS, EVALUATION, FLIGHTS, TRANSFER_TIMES, WARMSTART

COLUMNS: Mapping[str, Mapping[str, type]] = {
    EVALUATION: TABLES["trials"],
    WARMSTART: TABLES["warmstarts"],
    TRANSFER_TIMES: TABLES["transfer_times"],
    FLIGHTS: TABLES["flights"],
    ABLATIONS: TABLES["ablations"],
}
"""Columns and the type of their values, by experiment."""

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
    for name, kind in COLUMNS[run.experiment].items():
        if name not in table:
            raise unusable(run, TABLE, f"it has no column {name}")
        words, fitting = FITTING[kind]
        gaps = kind in WITHOUT_GAPS and table[name].hasnans
        if gaps or infer_dtype(table[name], skipna=True) not in fitting:
            raise unusable(run, TABLE, f"its column {name} does not hold {words} in every row")
    return table
