"""How good a trained model is on data, in units that do not depend on its recipe."""

import numpy as np

from pipeline.dataset.reading.examples import ExampleSource
from pipeline.networks.model import Model


def position_rmse(model: Model, examples: ExampleSource) -> float:
    """Root mean square distance of predicted node positions from the expert's, m."""
    squares, count = 0.0, 0
    for part in examples.parts():
        error = (model.predict(part.initial, part.goal) - part.states)[..., :3]
        squares += float(np.square(error).sum())
        count += error.size // 3
    return float(np.sqrt(squares / count))
