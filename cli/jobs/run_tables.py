"""Tables of experiments' runs: checked, averaged, and those averages in a model's own run."""

from collections.abc import Callable, Mapping
from typing import Any

import pandas as pd
from pandas.api.types import infer_dtype

from pipeline.experiments import averages as columns
from pipeline.experiments.averages import sizes_of_paper, summarize
from pipeline.experiments.example_transfer import example_transfer
from pipeline.experiments.experiment2 import QUANTITIES, sizes_figure
from pipeline.experiments.experiment3 import summarize_warmstarts
from pipeline.experiments.experiment4 import summarize_times
from pipeline.experiments.experiment5 import summarize_flights
from pipeline.experiments.records import PREDICTED, TABLES
from pipeline.experiments.trials import EvaluatedPlanner
from pipeline.experiments.verdicts import DECOUPLED
from pipeline.figures.style import planner_styles, save
from pipeline.figures.transfer import transfer_figure
from pipeline.planners.classical import Expert
from pipeline.scenario import Scenario
from pipeline.scratch import scratch_folder
from registry.metrics import add_model_results
from registry.models import ModelVersion
from registry.results import TABLE, Run, experiment_run, table_of, unusable_file
from registry.store import EVALUATION, FLIGHTS, TRANSFER_TIMES, WARMSTART

# The averages that a model's run has, by the name of its metric
COMPARED = {
    "trials": columns.TRIALS,
    "collisions": columns.COLLISIONS,
    "collisions_max": columns.MOST_COLLISIONS,
    "fuel": columns.FUEL,
    "fuel_ratio": columns.FUEL_RATIO,
    "safe_share": columns.SAFE,
    "boundary_error": columns.BOUNDARY,
    "dynamics_error": columns.DYNAMICS,
    "seconds": columns.SECONDS,
}
ERRORS = (columns.BOUNDARY, columns.DYNAMICS)  # of predictions; those of flown plans are rounding

KINDS: Mapping[str, tuple[str, Callable[[pd.DataFrame], pd.DataFrame]]] = {
    EVALUATION: ("trials", summarize),
    WARMSTART: ("warmstarts", summarize_warmstarts),
    TRANSFER_TIMES: ("transfer_times", summarize_times),
    FLIGHTS: ("flights", summarize_flights),
}
"""By experiment: its table's name in ``TABLES`` and ``Results``, and how trials are averaged."""

FITTING = {
    str: ("text", {"string"}),
    int: ("whole numbers", {"integer"}),
    float: ("numbers", {"floating", "integer", "mixed-integer-float"}),
    bool: ("true or false", {"boolean"}),
}
"""What columns of a type hold, in words and as pandas calls it."""


def sound_table(run: Run) -> pd.DataFrame:
    """A run's table: a row for each trial; InputError where columns are not its experiment's."""
    table = table_of(run).replace("own LP", DECOUPLED)  # its earlier name
    if table.empty:
        raise unusable_file(run, TABLE, "it has no rows")
    of_experiment, _ = KINDS[run.experiment]
    for name, kind in TABLES[of_experiment].items():
        if name not in table:
            raise unusable_file(run, TABLE, f"it has no column {name}")
        words, fitting = FITTING[kind]
        gaps = kind in (str, int) and table[name].hasnans
        if gaps or infer_dtype(table[name], skipna=True) not in fitting:
            raise unusable_file(run, TABLE, f"its column {name} does not hold {words} in every row")
    return table


def averages(run_id: str) -> list[dict[str, Any]]:
    """The averages of an experiment's run, as in the report: a row for each planner and setting."""
    run = experiment_run(run_id)
    trials, (_, averaged) = sound_table(run), KINDS[run.experiment]
    try:
        rows = averaged(trials)
    except Exception as error:  # of any kind: anyone may have written any values
        raise unusable_file(run, TABLE, f"its values have no averages: {error!r}") from error
    plain = rows.astype(object).where(rows.notna(), None)  # no number of pandas' own kinds
    return [dict(zip(rows.columns, row, strict=True)) for row in plain.itertuples(index=False)]


def add_to_model(
    version: ModelVersion,
    evaluated: EvaluatedPlanner,
    trials: pd.DataFrame,
    scenario: Scenario,
    dataset: tuple[str, str],
) -> None:
    """Add metrics, figures and the dataset (folder, digest) of an evaluation to a network's run."""
    same = (trials.planner == evaluated.planner.name) & (trials.recipe == evaluated.recipe)
    same &= trials.training_seed == evaluated.training_seed
    summary = summarize(trials[same | (trials.planner == Expert().name)])
    example = [EvaluatedPlanner(Expert()), evaluated]
    paper, style = sizes_of_paper(summary), planner_styles(summary["planner"])
    metrics = _metrics(summary[summary["planner"] == evaluated.planner.name], version.n)
    with scratch_folder() as scratch:
        for name in ("collisions", "fuel", "safe"):
            figure = sizes_figure(summary if paper.empty else paper, QUANTITIES[name], style)
            save(figure, scratch / name, [".png"])
        save(transfer_figure(example_transfer(scenario, example)), scratch / "transfer", [".png"])
        add_model_results(version, metrics, scratch, dataset=dataset)


def _metrics(mine: pd.DataFrame, n_train: int) -> dict[int, dict[str, float]]:
    """By step: experiment 2 at step n, experiment 1 at step 0."""
    found: dict[int, dict[str, float]] = {0: {}}
    for _, row in mine.iterrows():
        values = {
            f"{row.reading}_{metric}": float(row[average.source])
            for metric, average in COMPARED.items()
            if pd.notna(row[average.source]) and (row.reading == PREDICTED or average not in ERRORS)
        }
        n = int(row.n)
        found.setdefault(n, {}).update({f"exp2_{k}": v for k, v in values.items()})
        if n == n_train:
            found[0].update({f"exp1_{k}": v for k, v in values.items()})
    return found
