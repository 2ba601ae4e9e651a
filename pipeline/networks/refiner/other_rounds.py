"""A refiner that takes another number of rounds, and the rule without any network."""

from copy import copy
from dataclasses import replace
from typing import cast

import numpy as np
import torch
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.networks.model import Model, portions
from pipeline.networks.refiner.bargain import Bargain
from pipeline.networks.refiner.best import refined
from pipeline.networks.refiner.program import LEAST_FUEL, Program
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
    initial: Float[Array, "N n 6"],
    goal: Float[Array, "N n 6"],
    problem: Problem,
    rounds: int,
    program: Program = LEAST_FUEL,
) -> Float[Array, "N n _ 3"]:
    """Controls after some rounds by the rule alone, m/s².

    Args:
        initial: initial states of N swarms, m and m/s.
        goal: their goal states.
        problem: orbit, time grid and collision radius.
        rounds: how many; after none each craft keeps its own optimum.
        program: what each craft solves.
    """
    asked = portions(problem, initial, goal)
    return np.concatenate([refined(None, some, rounds, program).numpy() for some in asked])
