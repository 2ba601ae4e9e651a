"""Encoding of states as inputs and targets of networks, and decoding of their outputs."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pipeline.arrays import Array, Float
from pipeline.dataset.examples import ExampleSource
from pipeline.errors import check_choice
from pipeline.networks.document import EndStates
from pipeline.orbit.arrays import AnyState, AnyStates
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly, minimum_energy, straight_line

Trajectories = Float[Tensor, "b n T 6"]  # of batch, craft, node and state component


def _ends_alone(initial: AnyState, goal: AnyState, problem: Problem) -> AnyStates:
    """Trajectories that are zero between the first and the last state."""
    states = np.zeros((*initial.shape[:-1], problem.nodes, 6))
    states[..., 0, :], states[..., -1, :] = initial, goal
    return states


INTERIORS: dict[str, Callable[[AnyState, AnyState, Problem], AnyStates]] = {
    "line": lambda initial, goal, problem: straight_line(initial, goal, problem.nodes),
    "zeros": _ends_alone,
    "minimum-energy": lambda initial, goal, problem: fly(
        initial, minimum_energy(initial, goal, problem), problem
    ),
}
"""By name, the trajectories (m, m/s) in a network's input, whose interior the paper leaves open."""

# The output is the trajectory itself, as in the paper, or its offset from the input's.
TARGETS = STATES, OFFSET = "states", "offset"
# One scale for all six components, as in the paper's matrix of m and m/s, or one for each
SCALINGS = COMMON, COMPONENT = "common", "component"
LEAST_SHARE = 1e-6  # least scale of a component, as a share of the largest of its kind


@dataclass(frozen=True)
class Encoding:
    """Scaling of the paper's 6 x nT matrix (craft after craft), by which its values are near 1."""

    problem: Problem  # orbit, time grid and collision radius of the training data
    n: int  # spacecraft in each training instance
    interior: str  # what stands in the input between initial and goal state, of INTERIORS
    target: str  # STATES or OFFSET
    input_scale: tuple[float, ...]  # what each component of the inputs is divided by, m and m/s
    target_scale: tuple[float, ...]  # the same of the targets

    def __post_init__(self) -> None:
        check_choice("interior", self.interior, INTERIORS)
        check_choice("target", self.target, TARGETS)

    def inputs(self, initial: EndStates, goal: EndStates) -> Trajectories:
        """Inputs of the network, float64, from states in m and m/s."""
        states = INTERIORS[self.interior](initial, goal, self.problem)
        return torch.from_numpy(states / np.array(self.input_scale))

    def targets(self, states: Float[Array, "b n T 6"], inputs: Trajectories) -> Trajectories:
        """Targets of the network, float64, from states in m and m/s."""
        wanted = torch.from_numpy(states) - self._base(inputs)
        return wanted / wanted.new_tensor(self.target_scale)

    def decode(self, output: Trajectories, inputs: Trajectories) -> Trajectories:
        """States in m and m/s from outputs of the network."""
        return self._base(inputs) + output * output.new_tensor(self.target_scale)

    def _base(self, inputs: Trajectories) -> Trajectories:
        """The states that outputs are relative to."""
        if self.target == STATES:
            return torch.zeros_like(inputs)
        return inputs * inputs.new_tensor(self.input_scale)


def fit(examples: ExampleSource, interior: str, target: str, scaling: str = COMPONENT) -> Encoding:
    """The encoding whose scales come from training examples, in one pass over them.

    They are COMMON, the largest component's root mean square, or of each COMPONENT its own. Where
    there are no plans, the inputs stand for them. InputError for an unknown name.
    """
    check_choice("interior", interior, INTERIORS)
    check_choice("scaling", scaling, SCALINGS)
    count, squares = 0, np.zeros((2, 6))
    for part in examples.parts():
        given = INTERIORS[interior](part.initial, part.goal, part.problem)
        wanted = given if part.states is None else part.states
        wanted = wanted - given if target == OFFSET else wanted
        squares += [np.square(states).sum(axis=(0, 1, 2)) for states in (given, wanted)]
        count += given.shape[0] * given.shape[1] * given.shape[2]
    scales = (_scale(np.sqrt(square / count), scaling) for square in squares)
    return Encoding(examples.problem, examples.n, interior, target, *scales)


def _scale(size: Float[Array, "6"], scaling: str) -> tuple[float, ...]:
    """Scales from each component's root mean square; 1 where that of its kind is 0."""
    if scaling == COMMON:
        return (float(size.max()) or 1.0,) * 6
    kind = np.repeat(size.reshape(2, 3).max(axis=1), 3)  # positions, velocities
    size = np.maximum(size, LEAST_SHARE * kind)
    return tuple(float(s) for s in np.where(size > 0, size, 1.0))
