"""What an evaluation says about one network, in that network's own training run."""

from pathlib import Path

import pandas as pd

from cli.stages.entrants import Network
from pipeline.experiments import averages
from pipeline.experiments.averages import sizes_of_paper, summarize
from pipeline.experiments.examples import figure_transfer
from pipeline.experiments.experiment2 import QUANTITIES, sizes_figure
from pipeline.experiments.records import PREDICTED
from pipeline.experiments.trials import EvaluatedPlanner, example_transfer
from pipeline.figures.style import save, styles
from pipeline.planners.classical import Expert
from pipeline.scenario import Scenario
from pipeline.scratch import scratch_folder
from pipeline.storage.folder import Where
from registry.model_metrics import add_model_results

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
"""What a model's run has of the averages, by the name of its metric."""

ERRORS = (averages.BOUNDARY, averages.DYNAMICS)
"""Of predictions alone: what is flown has none but rounding."""

EXPERT = "expert"

DRAWN = ("collisions", "fuel", "safe")
"""Figures of experiment 2."""


def add_to_model(
    network: Network, trials: pd.DataFrame, scenario: Scenario, data: Where, digest: str
) -> None:
    """Add metrics, figures and the dataset to a network's run.

    Args:
        network: the network.
        trials: of all planners, columns of ``pipeline.experiments.trials.Trial``.
        scenario: a transfer to draw.
        data: the dataset's folder.
        digest: of its content.

    Raises:
        ProlearnError: where the store fails.
    """
    version = network.version
    same = (trials.planner == network.name) & (trials.recipe == version.recipe)
    mine = summarize(trials[same & (trials.training_seed == version.training_seed)])
    beside = summarize(trials[trials.planner == EXPERT])
    with scratch_folder() as scratch:
        _draw(scratch, pd.concat([beside, mine]), network, scenario)
        metrics = _metrics(mine, network.model.n_train)
        add_model_results(version, metrics, scratch, dataset=(str(data), digest))


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


def _draw(folder: Path, summary: pd.DataFrame, network: Network, scenario: Scenario) -> None:
    """Figures of experiment 2 and of one transfer, beside the expert's."""
    look = styles(summary["planner"])
    shown = sizes_of_paper(summary)
    for name in DRAWN:
        save(
            sizes_figure(summary if shown.empty else shown, QUANTITIES[name], look),
            folder / name,
            [".png"],
        )
    example = example_transfer(scenario, [EvaluatedPlanner(Expert()), network.entrant])
    save(figure_transfer(example), folder / "transfer", [".png"])
