"""The table of a run, with the columns that tables of its experiment have."""

from collections.abc import Mapping
from typing import get_type_hints

import pandas as pd
from pandas.api.types import infer_dtype

from pipeline.experiments.experiment3.rows import WarmStart
from pipeline.experiments.experiment5.rows import Flight
from pipeline.experiments.trials import Trial
from registry.artifacts import TABLE, unusable
from registry.results import table_of
from registry.runs import Run
from registry.store import ABLATIONS, EVALUATION, FLIGHTS, TRANSFER_TIMES, WARMSTART

_TRIAL = get_type_hints(Trial)

COLUMNS: Mapping[str, Mapping[str, type]] = {
    EVALUATION: _TRIAL,
    WARMSTART: get_type_hints(WarmStart),
    TRANSFER_TIMES: {"varied": str, "nodes": int, "time_step": float, **_TRIAL},
    FLIGHTS: get_type_hints(Flight),
    ABLATIONS: {"family": str, "rounds": int, "own_rounds": int, **_TRIAL},
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
