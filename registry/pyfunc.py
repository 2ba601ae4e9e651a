"""MLflow's loader of registered networks: from safetensors and JSON, nothing is unpickled."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mlflow.models import ModelSignature
from mlflow.types import Schema, TensorSpec

from pipeline.arrays import Array, Float64
from pipeline.networks.model import Model, load

_ENDS = (-1, -1, 6)
_FLOAT = np.dtype(np.float64)

SIGNATURE = ModelSignature(
    inputs=Schema([TensorSpec(_FLOAT, _ENDS, "initial"), TensorSpec(_FLOAT, _ENDS, "goal")]),
    outputs=Schema([TensorSpec(_FLOAT, (-1, -1, -1, 6))]),
)
"""Initial and goal states in, node states out, for any N and n."""


class TransferModel:
    """The model that ``mlflow.pyfunc.load_model`` wraps."""

    def __init__(self, model: Model) -> None:
        self.model = model

    def predict(
        self, model_input: Mapping[str, Any], params: Mapping[str, Any] | None = None
    ) -> Float64[Array, "N n T 6"]:
        """Node states, m and m/s, from ``initial`` and ``goal`` (N, n, 6), as MLflow checked."""
        initial, goal = (np.asarray(model_input[k], np.float64) for k in ("initial", "goal"))
        return self.model.predict(initial, goal)


def _load_pyfunc(data_path: str) -> TransferModel:
    """MLflow's entry point: the folder that ``pipeline.networks.model.save`` wrote."""
    return TransferModel(load(Path(data_path)))
