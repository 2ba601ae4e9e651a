"""Swarms as a network meets them, in m and m/s, and what an architecture makes of them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from pipeline.arrays import Array
from pipeline.orbit.problem import Problem

Batch = Mapping[str, Tensor]
"""What an architecture has prepared for some swarms; the first axis of each tensor is theirs."""


@dataclass(frozen=True, eq=False)
class Swarms:
    """Some swarms of one size on one orbit and time grid, in float64 on the CPU.

    Attributes:
        problem: the orbit and the time grid.
        initial: initial states, m and m/s.
        goal: goal states.
        collision_radius: of each swarm, m; it need not be the problem's.
        states: the expert's node states; not numbers where it has not planned, or None.
    """

    problem: Problem
    initial: Float64[Tensor, "b n 6"]
    goal: Float64[Tensor, "b n 6"]
    collision_radius: Float64[Tensor, "b"]
    states: Float64[Tensor, "b n T 6"] | None = None


def swarms(
    problem: Problem,
    initial: Float[Array, "b n 6"],
    goal: Float[Array, "b n 6"],
    states: Float[Array, "b n T 6"] | None = None,
) -> Swarms:
    """Swarms that share a problem, its collision radius included, without copies of the arrays."""
    radius = torch.full((len(initial),), problem.collision_radius, dtype=torch.float64)
    labels = None if states is None else _tensor(states)
    return Swarms(problem, _tensor(initial), _tensor(goal), radius, labels)


def _tensor(values: Float[Array, "..."]) -> Float64[Tensor, "..."]:
    """The same numbers, in the same memory where torch can share it."""
    return torch.from_numpy(np.require(values, np.float64, ["C", "W"]))
