"""How good a trained model is on data, in units that do not depend on its recipe."""

import numpy as np

from pipeline.dataset.examples import ExampleSource
from pipeline.networks.model import Model

POSITION_RMSE = "valid_position_rmse"
"""The metric of a training: the distance below, on its validation data."""


def position_rmse(model: Model, examples: ExampleSource) -> float:
    """Root mean square distance of predicted node positions from the expert's, m.

    It is no number where the expert has not planned.
    """
    squares, count = 0.0, 0
    for part in examples.parts():
        if part.states is not None:
            error = (model.predict(part.initial, part.goal) - part.states)[..., :3]
            squares += float(np.square(error).sum())
            count += error.size // 3
    return float(np.sqrt(squares / count)) if count else float("nan")
