"""A refiner that takes another number of rounds, and the rule without any network."""

from copy import copy
from dataclasses import replace
from typing import cast

import numpy as np
import torch
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.networks.model import COLUMNS_AT_ONCE, Model
from pipeline.networks.refiner.bargain import Bargain
from pipeline.networks.refiner.refiner import refined
from pipeline.networks.swarms import swarms
from pipeline.orbit.problem import Problem


def own_rounds(model: Model) -> int | None:
    """The rounds that a refiner's answer takes; None of a network of another kind."""
    return model.network.rounds if isinstance(model.network, Bargain) else None


def with_rounds(model: Model, rounds: int) -> Model:
    """A refiner with the same weights whose answer takes so many rounds."""
    network = cast("Bargain", copy(model.network))  # shares the weights
    network.rounds = rounds
    return replace(model, config={**model.config, "rounds": rounds}, network=network)


@torch.inference_mode()
def by_rule(
    initial: Float[Array, "N n 6"], goal: Float[Array, "N n 6"], problem: Problem, rounds: int
) -> Float[Array, "N n _ 3"]:
    """Controls after some rounds by the rule alone, m/s².

    Args:
        initial: initial states of N swarms, m and m/s.
        goal: their goal states.
        problem: orbit, time grid and collision radius.
        rounds: how many; after none each craft keeps its own optimum.
    """
    step = max(1, COLUMNS_AT_ONCE // (initial.shape[1] * problem.nodes))
    parts = [slice(start, start + step) for start in range(0, len(initial), step)]
    asked = (swarms(problem, initial[part], goal[part]) for part in parts)
    return np.concatenate([refined(None, some, rounds).numpy() for some in asked])
