"""What an evaluation says about one network, in that network's own training run."""

from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd

from pipeline.dataset.folder import Where
from pipeline.report.figures_scaling import COLLISIONS, FUEL, SAFE, scaling_figure
from pipeline.report.figures_transfer import figure_transfer
from pipeline.report.results import PREDICTED, Example
from pipeline.report.style import save, styles
from registry.jobs.entrants import Network
from registry.results import ModelResults, add_model_results

COMPARED = {
    "collisions": "collisions_mean",
    "collisions_max": "collisions_max",
    "fuel": "fuel_mean",
    "fuel_ratio": "fuel_ratio",
    "safe_share": "safe_share",
    "boundary_error": "boundary_error",
    "dynamics_error": "dynamics_error",
    "seconds": "seconds_mean",
}
"""Metrics of a model's run, by the column of the summary that they come from."""

ERRORS = {"boundary_error", "dynamics_error"}
"""Of predictions alone: what is flown has none but rounding."""

EXPERT = "expert"


def add_to_model(
    network: Network, summary: pd.DataFrame, example: Example, data: Where, digest: str
) -> None:
    """Add metrics, figures and the dataset to a network's run.

    Args:
        network: the network.
        summary: of all planners, as ``pipeline.report.summary.summarize`` gives it.
        example: one transfer as every planner flies it.
        data: the dataset's folder.
        digest: of its content.

    Raises:
        ProlearnError: where the store fails.
    """
    mine = summary[(summary.planner == network.name) & (summary.recipe == network.version.recipe)]
    with TemporaryDirectory(prefix="prolearn-") as scratch:
        beside = pd.concat([summary[summary.planner == EXPERT], mine])
        _draw(Path(scratch), beside, _only(example, network))
        results = ModelResults(_metrics(mine, network.model.n_train), Path(scratch))
        add_model_results(network.version, results, data=str(data), digest=digest)


def _metrics(mine: pd.DataFrame, n_train: int) -> dict[int, dict[str, float]]:
    """By step: experiment 2 at step n, experiment 1 at step 0."""
    found: dict[int, dict[str, float]] = {0: {}}
    for _, row in mine.iterrows():
        values = {
            f"{row.reading}_{metric}": float(row[column])
            for metric, column in COMPARED.items()
            if pd.notna(row[column]) and (row.reading == PREDICTED or metric not in ERRORS)
        }
        n = int(row.n)
        found.setdefault(n, {}).update({f"exp2_{k}": v for k, v in values.items()})
        if n == n_train:
            found[0].update({f"exp1_{k}": v for k, v in values.items()})
    return found


def _draw(folder: Path, summary: pd.DataFrame, example: Example) -> None:
    """Figures of experiment 2 and of one transfer, beside the expert's."""
    look = styles(summary["planner"])
    for name, quantity in (("collisions", COLLISIONS), ("fuel", FUEL), ("safe", SAFE)):
        save(scaling_figure(summary, quantity, look), folder / name, [".png"])
    save(figure_transfer(example), folder / "transfer", [".png"])


def _only(example: Example, network: Network) -> Example:
    """The transfer as the expert and one network fly it."""
    wanted = (EXPERT, f"{network.name} {network.version.recipe}")
    tracks = {label: example.tracks[label] for label in wanted if label in example.tracks}
    return Example(example.title, example.initial, example.goal, tracks, example.collision_radius)
