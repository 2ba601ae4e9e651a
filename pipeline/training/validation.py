"""How good a trained model is on data, in units that do not depend on its recipe."""

import numpy as np

from pipeline.dataset.examples import Examples
from pipeline.networks.model import Model


def position_rmse(model: Model, examples: Examples) -> float:
    """Root mean square distance of predicted node positions from the expert's, m."""
    error = (model.predict(examples.initial, examples.goal) - examples.states)[..., :3]
    return float(np.sqrt(np.square(error).sum(axis=-1).mean()))
