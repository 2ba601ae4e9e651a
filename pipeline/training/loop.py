"""The training loop: Adam on shuffled batches; the weights with the best validation are kept."""

import math
import time
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from inspect import unwrap

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim.lr_scheduler import CosineAnnealingLR
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from pipeline.arrays import Float
from pipeline.dataset.examples import ExampleSource, ExampleStream
from pipeline.errors import ProlearnError
from pipeline.networks.architecture import Architecture, find
from pipeline.networks.device import torch_device
from pipeline.networks.encoding import Encoding, fit
from pipeline.networks.model import Model
from pipeline.networks.recipes import COSINE, Recipe
from pipeline.progress import SILENT, Progress
from pipeline.training.data import Batches, Prepared, batches, check_examples, prepare

VALIDATION_BATCH = 256  # instances whose validation score is computed at once
POSITION_RMSE = "valid_position_rmse"  # metric: ``position_rmse`` on the validation data


@dataclass(frozen=True)
class Epoch:
    """One pass over the training data, numbered from 1."""

    number: int
    train_loss: float  # mean loss of the pass, with dropout, while the weights change
    valid_loss: float  # the architecture's score on the validation data after it; lower is better
    seconds: float


@dataclass(frozen=True, eq=False)
class Trained:
    """A model with the weights of its best epoch, on the CPU, and how it was trained."""

    model: Model
    recipe: Recipe
    seed: int
    history: tuple[Epoch, ...]
    best_epoch: int
    seconds: float
    device: str
    threads: int = 1
    shuffle_buffer: int | None = None  # its size in instances; None: no such buffer


@dataclass(frozen=True, eq=False)
class TrainingObjective:
    """Loss and validation score of a network, on the device of its batches."""

    architecture: Architecture
    network: nn.Module
    encoding: Encoding
    recipe: Recipe

    def loss(self, batch: Prepared) -> Float[Tensor, ""]:
        """The mean loss over a batch."""
        return self.architecture.loss(self.network, batch.tensors, self.encoding, self.recipe)

    @torch.no_grad()
    def score(self, data: Batches) -> float:
        """The mean score over validation data."""
        self.network.eval()
        total = 0.0
        for batch in data.in_order(VALIDATION_BATCH):
            given = (batch.tensors, self.encoding, self.recipe)
            total += float(self.architecture.score(self.network, *given)) * len(batch)
        return total / len(data)


class _Adam(torch.optim.Adam):
    """Adam optimizer without the import of torch's compiler, which takes a second."""

    add_param_group = unwrap(torch.optim.Optimizer.add_param_group)
    zero_grad = unwrap(torch.optim.Optimizer.zero_grad)
    step = torch.no_grad()(unwrap(torch.optim.Adam.step))


class Descent:
    """Adam with a recipe's learning-rate schedule, gradient clipping and weight averaging."""

    def __init__(self, network: nn.Module, recipe: Recipe, steps: int) -> None:
        self.network = network
        self.optimizer = _Adam(network.parameters(), lr=recipe.learning_rate)
        self._limit = recipe.gradient_limit
        cosine = recipe.schedule == COSINE
        self._schedule = CosineAnnealingLR(self.optimizer, T_max=steps) if cosine else None
        self._mean = None
        if recipe.averaging:
            average = get_ema_multi_avg_fn(recipe.averaging)  # type: ignore[no-untyped-call]
            self._mean = AveragedModel(network, multi_avg_fn=average)

    @property
    def result(self) -> nn.Module:
        """The network that is scored and kept: itself, or its moving average."""
        return self.network if self._mean is None else self._mean.module

    def step(self, loss: Float[Tensor, ""]) -> None:
        """Change the weights by the gradient of a loss."""
        self.optimizer.zero_grad()
        torch.autograd.backward(loss)
        if self._limit:
            nn.utils.clip_grad_norm_(self.network.parameters(), self._limit)
        self.optimizer.step()
        if self._schedule is not None:
            self._schedule.step()
        if self._mean is not None:
            self._mean.update_parameters(self.network)


def train(
    arch: str,
    recipe: Recipe,
    train: ExampleSource,
    valid: ExampleSource,
    *,
    seed: int = 0,
    device: str = "auto",
    progress: Progress = SILENT,
) -> Trained:
    """Train a network; on one machine's CPU the same arguments give the same bits.

    The n and problem of the training examples become the model's; those for validation decide when
    to stop and which weights to keep. The seed determines initial weights, order and dropout;
    ``device`` is "auto", "cpu", "cuda" or "mps". InputError for an unknown architecture or device,
    or unusable examples; ProlearnError where loss or score cease to be finite. Its seconds exclude
    what the first training of a process imports and compiles.
    """
    architecture, chosen = find(arch), torch_device(device)
    torch.zeros(1, device=chosen)  # sets up a GPU before the clock starts
    started = time.perf_counter()
    check_examples(train, valid)
    encoding = fit(train, recipe.interior, recipe.target, recipe.scaling)
    devices = [] if chosen.type == "cpu" else [chosen.index or 0]
    with torch.random.fork_rng(devices, device_type=chosen.type):
        torch.manual_seed(seed)
        network = architecture.network(architecture.config, encoding, recipe.dropout).to(chosen)
        objective = TrainingObjective(architecture, network, encoding, recipe)
        ready = partial(prepare, architecture, encoding, chosen)
        data = batches(train, ready), batches(valid, ready)
        prepared = time.perf_counter()
        with torch.random.fork_rng(devices, device_type=chosen.type):
            _warm_up(objective, data[1])
        started += time.perf_counter() - prepared
        history, best = _improve(objective, *data, seed, progress)
    model = Model(arch, architecture.config, recipe.name, encoding, network.cpu())
    seconds = time.perf_counter() - started
    buffer = train.buffer if isinstance(train, ExampleStream) and not train.endless else None
    return Trained(
        model, recipe, seed, history, best, seconds, str(chosen), torch.get_num_threads(), buffer
    )


def _warm_up(objective: TrainingObjective, data: Batches) -> None:
    """Train a copy for one step, since the first imports and compiles, for seconds or minutes."""
    copy = replace(objective, network=deepcopy(objective.network))
    batch = next(iter(data.in_order(2)))
    Descent(copy.network, copy.recipe, steps=1).step(copy.loss(batch))
    copy.score(batch)


def _improve(
    objective: TrainingObjective, train: Batches, valid: Batches, seed: int, progress: Progress
) -> tuple[tuple[Epoch, ...], int]:
    """Train the network for all epochs, restore the best weights, and return the best epoch."""
    recipe, epochs = objective.recipe, objective.recipe.epochs
    descent = Descent(objective.network, recipe, epochs * math.ceil(len(train) / recipe.batch_size))
    scored = replace(objective, network=descent.result)
    order = torch.Generator().manual_seed(seed)
    history: list[Epoch] = []
    progress.expect(epochs)
    best, kept = 0, deepcopy(scored.network.state_dict())
    for number in range(1, epochs + 1):
        started = time.perf_counter()
        train_loss = pass_over(objective, descent, train, order)
        valid_loss = scored.score(valid)
        if not (math.isfinite(train_loss) and math.isfinite(valid_loss)):
            raise ProlearnError(
                f"the loss is no longer a finite number in epoch {number}; lower the learning rate."
            )
        history.append(Epoch(number, train_loss, valid_loss, time.perf_counter() - started))
        if best == 0 or valid_loss < history[best - 1].valid_loss:
            best, kept = number, deepcopy(scored.network.state_dict())
        progress.done(note=f"loss {valid_loss:.4g}")
        if number - best >= recipe.patience:
            break
    progress.end("ended early")
    objective.network.load_state_dict(kept)
    return tuple(history), best


def pass_over(
    objective: TrainingObjective, descent: Descent, data: Batches, order: torch.Generator
) -> float:
    """One epoch of steps on batches in random order; returns the mean loss."""
    objective.network.train()
    total: Tensor | float = 0.0  # read once, so that CUDA need not wait
    for batch in data.shuffled(objective.recipe.batch_size, order):
        loss = objective.loss(batch)
        descent.step(loss)
        total = total + loss.detach() * len(batch)
    return float(total) / len(data)


def position_rmse(model: Model, examples: ExampleSource) -> float:
    """RMS distance of predicted node positions from the expert's, m; NaN without its plans."""
    squares, count = 0.0, 0
    for part in examples.parts():
        if part.states is not None:
            error = (model.predict(part.initial, part.goal) - part.states)[..., :3]
            squares += float(np.square(error).sum())
            count += error.size // 3
    return float(np.sqrt(squares / count)) if count else float("nan")
