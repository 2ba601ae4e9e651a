"""The trained refiner that comes with the package: it plans right away, and without torch."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from safetensors.numpy import load as arrays_from

from pipeline.arrays import Array
from pipeline.networks.document import Answer, Ends, portions, read_model, read_weights
from pipeline.networks.recipes import REFINER
from pipeline.networks.refiner.model import Weights, answer
from pipeline.orbit.problem import Problem

FOLDER = Path(__file__).parent / "default"  # weights, description and model card


@dataclass(frozen=True, eq=False)
class TrainedRefiner:
    """A trained refiner as arrays: a ``TrainedNetwork`` for any n, on any orbit and time grid."""

    weights: Weights | None  # by name; None for rounds without trades
    rounds: int  # that an answer takes
    problem: Problem  # of its training data, or that it is asked about
    digest: str  # SHA-256 of all that decides its answers

    architecture: ClassVar[str] = REFINER
    answers: ClassVar[Answer] = "controls"

    def on(self, problem: Problem) -> "TrainedRefiner":
        """The same weights for another problem."""
        return replace(self, problem=problem)

    def answer(self, initial: Ends, goal: Ends, collision_radius: float) -> Float[Array, "N n _ 3"]:
        """Controls of each swarm, m/s²."""
        radius = np.full(len(initial), collision_radius)
        how = self.weights, self.rounds, self.problem
        found = [
            answer(*how, initial[k], goal[k], radius[k])
            for k in portions(initial, goal, self.problem.nodes)
        ]
        return np.concatenate(found)


@lru_cache(maxsize=1)
def packaged() -> TrainedRefiner:
    """The packaged model."""
    document = read_model(FOLDER)
    weights = read_weights(FOLDER, document.weights_sha256, arrays_from)
    problem = Problem(**document.problem.model_dump())
    return TrainedRefiner(weights, document.config["rounds"], problem, document.digest)
