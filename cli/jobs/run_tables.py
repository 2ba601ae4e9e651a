"""Tables of experiments' runs: checked, averaged, and those averages in a model's own run."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from pandas.api.types import infer_dtype

from cli.jobs.networks import EvaluatedNetwork
from pipeline.experiments import averages as columns
from pipeline.experiments.ablations import summarize_ablations
from pipeline.experiments.averages import sizes_of_paper, summarize
from pipeline.experiments.experiment2 import QUANTITIES, sizes_figure
from pipeline.experiments.experiment3 import summarize_warmstarts
from pipeline.experiments.experiment4 import summarize_times
from pipeline.experiments.experiment5 import summarize_flights
from pipeline.experiments.records import PREDICTED, TABLES
from pipeline.experiments.trials import EvaluatedPlanner, example_transfer
from pipeline.figures.style import save, styles
from pipeline.figures.transfer import transfer_figure
from pipeline.planners.classical import Expert
from pipeline.scenario import Scenario
from pipeline.scratch import scratch_folder
from registry.results import Run, experiment_run
from registry.run_files import TABLE, table_of, unusable
from registry.store import ABLATIONS, EVALUATION, FLIGHTS, TRANSFER_TIMES, WARMSTART
from registry.training import add_model_results


@dataclass(frozen=True)
class Kind:
    """The table that runs of an experiment have, and how its trials are averaged."""

    name: str  # in ``TABLES``, which has its columns, and in a report's ``Results``
    averages: Callable[[pd.DataFrame], pd.DataFrame]


COMPARED = {
    "collisions": columns.COLLISIONS,
    "collisions_max": columns.MOST_COLLISIONS,
    "fuel": columns.FUEL,
    "fuel_ratio": columns.FUEL_RATIO,
    "safe_share": columns.SAFE,
    "boundary_error": columns.BOUNDARY,
    "dynamics_error": columns.DYNAMICS,
    "seconds": columns.SECONDS,
}
"""The averages that a model's run has, by the name of its metric."""

ERRORS = (columns.BOUNDARY, columns.DYNAMICS)
"""Averages of predictions alone: flown plans have no such errors but rounding."""

DRAWN = ("collisions", "fuel", "safe")
"""Figures of experiment 2."""

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


def add_to_model(
    network: EvaluatedNetwork, trials: pd.DataFrame, scenario: Scenario, dataset: tuple[str, str]
) -> None:
    """Add metrics, figures and the dataset (folder, digest) of an evaluation to a network's run."""
    same = (trials.planner == network.planner.name) & (trials.recipe == network.recipe)
    mine = summarize(trials[same & (trials.training_seed == network.training_seed)])
    beside = summarize(trials[trials.planner == Expert().name])
    with scratch_folder() as scratch:
        _draw(scratch, pd.concat([beside, mine]), network, scenario)
        metrics = _metrics(mine, network.predictor.n_train)
        add_model_results(network.version, metrics, scratch, dataset=dataset)


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


def _draw(
    folder: Path, summary: pd.DataFrame, network: EvaluatedNetwork, scenario: Scenario
) -> None:
    """Figures of experiment 2 and of one transfer, beside the expert's."""
    style = styles(summary["planner"])
    paper = sizes_of_paper(summary)
    shown = summary if paper.empty else paper
    for name in DRAWN:
        save(sizes_figure(shown, QUANTITIES[name], style), folder / name, [".png"])
    example = example_transfer(scenario, [EvaluatedPlanner(Expert()), network])
    save(transfer_figure(example), folder / "transfer", [".png"])
