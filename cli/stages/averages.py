"""What an experiment comes to, in numbers: the averages that its table in the report has."""

from collections.abc import Callable, Mapping
from typing import Any

import pandas as pd

from cli.stages.run_tables import sound_table
from pipeline.experiments.ablations import summarize_ablations
from pipeline.experiments.averages import summarize
from pipeline.experiments.experiment3 import summarize_warmstarts
from pipeline.experiments.experiment4 import summarize_times
from pipeline.experiments.experiment5 import summarize_flights
from registry.artifacts import TABLE, unusable
from registry.results import experiment_run
from registry.store import ABLATIONS, EVALUATION, FLIGHTS, TRANSFER_TIMES, WARMSTART

SUMMARIES: Mapping[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    EVALUATION: summarize,
    WARMSTART: summarize_warmstarts,
    TRANSFER_TIMES: summarize_times,
    FLIGHTS: summarize_flights,
    ABLATIONS: summarize_ablations,
}
"""How the trials of an experiment are summed up, by its name in MLflow."""


def averages(run_id: str) -> list[dict[str, Any]]:
    """The averages of a run of an experiment, a row each planner or seed and setting.

    Raises:
        InputError: where its table is damaged.
        ProlearnError: where the store fails.
    """
    run = experiment_run(run_id)
    trials = sound_table(run)
    try:
        rows = SUMMARIES[run.experiment](trials)
    except Exception as error:  # of any kind: anyone may have written any values
        raise unusable(run, TABLE, f"its values have no averages: {error!r}") from error
    plain = rows.astype(object).where(rows.notna(), None)  # no number of pandas' own kinds
    return [dict(zip(rows.columns, row, strict=True)) for row in plain.itertuples(index=False)]
