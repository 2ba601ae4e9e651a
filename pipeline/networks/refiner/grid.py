"""A problem as tensors, in the units that make all swarms alike: r_col and Δt.

Relative motion is linear and fuel is a norm, so a swarm twice as large with twice the collision
radius has the same transfers at twice the fuel. In units of r_col and Δt nothing is left of that:
positions are in r_col, velocities in r_col/Δt, controls in r_col/Δt².
"""

from dataclasses import dataclass
from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import transfer_maps


@dataclass(frozen=True, eq=False)
class Grid:
    """What is constant for a problem; s = drift s₁ + reach u holds for all nodes at once.

    Attributes:
        nodes: T.
        step: Δt, s.
        drift: (6T, 6).
        reach: (6T, m), with m = 3(T-1) controls.
        free: takes from controls the part that changes the final state, (m, m), symmetric.
    """

    nodes: int
    step: float
    drift: Float[Tensor, "_ 6"]
    reach: Float[Tensor, "_ m"]
    free: Float[Tensor, "m m"]

    @property
    def to_goal(self) -> Float[Tensor, "6 m"]:
        """R: what the controls change of the final state."""
        return self.reach[-6:]

    def fly(
        self, initial: Float[Tensor, "N 6"], controls: Float[Tensor, "N m"]
    ) -> Float[Tensor, "N T 6"]:
        """Node states."""
        return (initial @ self.drift.T + controls @ self.reach.T).reshape(-1, self.nodes, 6)


@lru_cache(maxsize=32)
@torch.inference_mode(mode=False)  # what is kept must serve training too
def grid_of(problem: Problem, device: torch.device) -> Grid:
    """The grid of a problem, made once; its collision radius has no part in it."""
    maps, step = transfer_maps(problem), problem.time_step
    per_step = _per_step(step)
    drift, reach = torch.from_numpy(maps.drift), torch.from_numpy(maps.reach)
    drift = (drift * per_step[:, None] / per_step).reshape(-1, 6)
    reach = (reach * per_step[:, None] / step**2).reshape(len(drift), -1)
    goal = reach[-6:]
    free = torch.eye(len(reach.T), dtype=reach.dtype) - torch.linalg.pinv(goal) @ goal
    return Grid(problem.nodes, step, *(part.to(device) for part in (drift, reach, free)))


def in_units(
    states: Float[Tensor, "b n 6"], radius: Float[Tensor, "b"], problem: Problem
) -> Float[Tensor, "_ 6"]:
    """States of all craft, one after the other, from m and m/s."""
    scaled = states * _per_step(problem.time_step).to(states.device)
    return (scaled / radius[:, None, None]).reshape(-1, 6)


def _per_step(step: float) -> Float[Tensor, "6"]:
    """What turns m and m/s into lengths."""
    return torch.tensor([1.0, step], dtype=torch.float64).repeat_interleave(3)
