"""The answer of the rounds: of each swarm the cheapest iterate that is safe."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from pipeline.networks.refiner.bargain import Bargain
from pipeline.networks.refiner.program import LEAST_FUEL, Program
from pipeline.networks.refiner.rounds import SAFE, State, Task, begin, play, start
from pipeline.networks.swarms import Swarms

STEADY = 1e-4
"""Share by which fuel must change in a round that leaves a swarm safe, or it is its last."""


def refined(
    network: Bargain | None, swarms: Swarms, count: int, program: Program = LEAST_FUEL
) -> Float[Tensor, "b n _ 3"]:
    """Controls after so many rounds, m/s²; by the rule alone without a network."""
    controls, _ = best_of(network, begin(swarms), count, program)
    unit = swarms.collision_radius / swarms.problem.time_step**2
    b, n, _ = swarms.initial.shape
    return controls.reshape(b, n, -1, 3) * unit[:, None, None, None]


def best_of(
    network: Bargain | None, task: Task, count: int, program: Program = LEAST_FUEL
) -> tuple[Float[Tensor, "N m"], Bool[Tensor, "b"]]:
    """The cheapest safe iterate of each swarm, or else the last one; and whether it is safe.

    A swarm whose own optima are safe keeps them; any other goes on until a round leaves it safe and
    its fuel next to unchanged.
    """
    state = start(task)
    best, least = state.controls, _safe_fuel(task, state)
    going = least.isinf()
    for number in range(count):
        if not going.any():
            break
        before = task.fuel(state.controls)
        state = play(network, task, state, number, going, program)
        fuel = _safe_fuel(task, state)
        better = (fuel < least) | least.isinf()
        best = torch.where(better.repeat_interleave(task.n)[:, None], state.controls, best)
        going = going & ~((fuel - before).abs() <= STEADY * before)
        least = least.minimum(fuel)
    return best, least.isfinite()


def _safe_fuel(task: Task, state: State) -> Float[Tensor, "b"]:
    """Fuel of each swarm, infinite where it is not safe."""
    close = (state.found.distance < SAFE).to(state.controls.dtype)
    safe = task.total(close, task.swarm) == 0
    return torch.where(safe, task.fuel(state.controls), torch.inf)
