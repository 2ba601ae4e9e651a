"""Steps of Adam with what a recipe adds to them: a schedule, a limit, averaged weights."""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.optim.lr_scheduler import ConstantLR, CosineAnnealingLR, LRScheduler
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from pipeline.networks.recipes import COSINE, Recipe


class Descent:
    """A network on its way down its loss.

    Attributes:
        network: what learns.
        optimizer: Adam.
    """

    def __init__(self, network: nn.Module, recipe: Recipe, steps: int) -> None:
        """Begin, with so many steps ahead."""
        self.network = network
        self.optimizer = torch.optim.Adam(network.parameters(), lr=recipe.learning_rate)
        self._limit = recipe.gradient_limit
        self._schedule = _schedule(self.optimizer, recipe.schedule, steps)
        self._mean = None
        if recipe.averaging:
            average = get_ema_multi_avg_fn(recipe.averaging)  # type: ignore[no-untyped-call]
            self._mean = AveragedModel(network, multi_avg_fn=average)

    @property
    def result(self) -> nn.Module:
        """What is scored and kept: the network, or one with the mean of its weights."""
        return self.network if self._mean is None else self._mean.module

    def step(self, loss: Float[Tensor, ""]) -> None:
        """Change the weights by the gradient of a loss."""
        self.optimizer.zero_grad()
        torch.autograd.backward(loss)
        if self._limit:
            nn.utils.clip_grad_norm_(self.network.parameters(), self._limit)
        self.optimizer.step()
        self._schedule.step()
        if self._mean is not None:
            self._mean.update_parameters(self.network)


def _schedule(optimizer: torch.optim.Optimizer, name: str, steps: int) -> LRScheduler:
    if name == COSINE:
        return CosineAnnealingLR(optimizer, T_max=steps)
    return ConstantLR(optimizer, factor=1.0)
