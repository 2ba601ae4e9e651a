"""What an evaluation says about one network, in that network's own training run."""

from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd

from cli.stages.entrants import Network
from pipeline.dataset.storage.folder import Where
from pipeline.exhibits.style import save, styles
from pipeline.experiments.examples.figure import figure_transfer
from pipeline.experiments.examples.run import example_transfer
from pipeline.experiments.experiment2.figure import QUANTITIES, scaling_figure
from pipeline.experiments.summary import (
    BOUNDARY,
    COLLISIONS,
    DYNAMICS,
    FUEL,
    FUEL_RATIO,
    MOST_COLLISIONS,
    SAFE,
    SECONDS,
    summarize,
)
from pipeline.experiments.trials import PREDICTED, Entrant
from pipeline.planners.expert import Expert
from pipeline.scenario import Scenario
from registry.results import ModelResults, add_model_results

COMPARED = {
    "collisions": COLLISIONS,
    "collisions_max": MOST_COLLISIONS,
    "fuel": FUEL,
    "fuel_ratio": FUEL_RATIO,
    "safe_share": SAFE,
    "boundary_error": BOUNDARY,
    "dynamics_error": DYNAMICS,
    "seconds": SECONDS,
}
"""What a model's run has of the averages, by the name of its metric."""

ERRORS = (BOUNDARY, DYNAMICS)
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
    with TemporaryDirectory(prefix="prolearn-") as scratch:
        _draw(Path(scratch), pd.concat([beside, mine]), network, scenario)
        results = ModelResults(_metrics(mine, network.model.n_train), Path(scratch))
        add_model_results(version, results, data=str(data), digest=digest)


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
    for name in DRAWN:
        save(scaling_figure(summary, QUANTITIES[name], look), folder / name, [".png"])
    example = example_transfer(scenario, [Entrant(Expert()), network.entrant])
    save(figure_transfer(example), folder / "transfer", [".png"])
