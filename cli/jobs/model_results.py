"""Metrics and figures of an evaluation for the training run of one network."""

from pathlib import Path

import pandas as pd

from cli.jobs.networks import EvaluatedNetwork
from pipeline.experiments import averages
from pipeline.experiments.averages import sizes_of_paper, summarize
from pipeline.experiments.examples import figure_transfer
from pipeline.experiments.experiment2 import QUANTITIES, sizes_figure
from pipeline.experiments.records import PREDICTED
from pipeline.experiments.trials import EvaluatedPlanner, example_transfer
from pipeline.figures.style import save, styles
from pipeline.planners.expert import Expert
from pipeline.scenario import Scenario
from pipeline.scratch import scratch_folder
from registry.training import add_model_results

COMPARED = {
    "collisions": averages.COLLISIONS,
    "collisions_max": averages.MOST_COLLISIONS,
    "fuel": averages.FUEL,
    "fuel_ratio": averages.FUEL_RATIO,
    "safe_share": averages.SAFE,
    "boundary_error": averages.BOUNDARY,
    "dynamics_error": averages.DYNAMICS,
    "seconds": averages.SECONDS,
}
"""The averages that a model's run has, by the name of its metric."""

ERRORS = (averages.BOUNDARY, averages.DYNAMICS)
"""Of predictions alone: what is flown has none but rounding."""

EXPERT = "expert"

DRAWN = ("collisions", "fuel", "safe")
"""Figures of experiment 2."""


def add_to_model(
    network: EvaluatedNetwork, trials: pd.DataFrame, scenario: Scenario, dataset: tuple[str, str]
) -> None:
    """Add metrics, figures and the dataset to a network's run.

    Args:
        network: the network.
        trials: of all planners, columns of ``pipeline.experiments.trials.Trial``.
        scenario: a transfer to draw.
        dataset: folder and digest of the dataset.
    """
    same = (trials.planner == network.planner.name) & (trials.recipe == network.recipe)
    mine = summarize(trials[same & (trials.training_seed == network.training_seed)])
    beside = summarize(trials[trials.planner == EXPERT])
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
    save(figure_transfer(example), folder / "transfer", [".png"])
