"""The training loop: Adam on shuffled batches, the best weights on validation kept."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.dataset.reading.examples import ExampleSource
from pipeline.errors import InputError, ProlearnError
from pipeline.networks.architecture import Architecture, find
from pipeline.networks.encoding import Encoding, fit
from pipeline.networks.model import Model
from pipeline.progress import SILENT, Progress
from pipeline.training.data import Batches, Encoded, batches, check_examples
from pipeline.training.device import training_device
from pipeline.training.recipes import Recipe

VALIDATION_BATCH = 256
"""Instances whose validation loss is computed at once."""


@dataclass(frozen=True)
class Epoch:
    """One pass over the training data.

    Attributes:
        number: from 1.
        train_loss: mean loss of the pass, with dropout, while the weights change.
        valid_loss: mean loss on the validation data after it.
        seconds: how long it took.
    """

    number: int
    train_loss: float
    valid_loss: float
    seconds: float


@dataclass(frozen=True, eq=False)
class Trained:
    """What training gives.

    Attributes:
        model: with the weights of the best epoch, on the CPU.
        history: all epochs.
        best_epoch: number of the epoch with the least validation loss.
        seconds: how long it took in all.
        device: where it ran.
        threads: of torch that it ran on.
    """

    model: Model
    history: tuple[Epoch, ...]
    best_epoch: int
    seconds: float
    device: str
    threads: int = 1


@dataclass(frozen=True, eq=False)
class Task:
    """A network and the loss that it is to make small.

    Attributes:
        architecture: whose loss it is.
        network: what is trained, on the device of the batches.
        encoding: what the batches are in.
        collision_weight: weight of the collision penalty, where the architecture has one.
    """

    architecture: Architecture
    network: nn.Module
    encoding: Encoding
    collision_weight: float

    def loss(self, batch: Encoded) -> Float[Tensor, ""]:
        """The mean loss over a batch."""
        return self.architecture.loss(
            self.network, batch.inputs, batch.target, self.encoding, self.collision_weight
        )


def train(
    arch: str,
    recipe: Recipe,
    train: ExampleSource,
    valid: ExampleSource,
    *,
    seed: int = 0,
    device: str = "auto",
    epochs: int | None = None,
    progress: Progress = SILENT,
) -> Trained:
    """Train a network; on one machine's CPU the same arguments give the same bits.

    Args:
        arch: name of the architecture.
        recipe: how to train it.
        train: what it learns from, in memory or a stream; its n and problem become the model's.
        valid: what decides when to stop and which weights to keep.
        seed: of initial weights, order and dropout.
        device: "auto", "cpu", "cuda" or "mps".
        epochs: most passes over the data, instead of the recipe's.
        progress: told of each epoch.

    Raises:
        InputError: for an unknown architecture or device, or examples that cannot be used.
        ProlearnError: where the loss ceases to be a finite number.
    """
    started = time.perf_counter()
    most = recipe.epochs if epochs is None else epochs
    if most < 1:
        raise InputError(f"epochs is {most}; expected at least 1.")
    architecture, where = find(arch), training_device(device)
    check_examples(train, valid)
    encoding = fit(train, recipe.interior, recipe.target, recipe.scaling)
    with _seeded(seed, where):
        network = architecture.network(architecture.config, encoding, recipe.dropout).to(where)
        task = Task(architecture, network, encoding, recipe.collision_weight)
        data = batches(train, encoding, where), batches(valid, encoding, where)
        history, best = _improve(task, recipe, *data, most, seed, progress)
    model = Model(arch, architecture.config, recipe.name, encoding, network.cpu())
    seconds = time.perf_counter() - started
    return Trained(model, history, best, seconds, str(where), torch.get_num_threads())


def _improve(
    task: Task,
    recipe: Recipe,
    train: Batches,
    valid: Batches,
    epochs: int,
    seed: int,
    progress: Progress,
) -> tuple[tuple[Epoch, ...], int]:
    """All epochs and the number of the best, whose weights the network is left with."""
    optimizer = torch.optim.Adam(task.network.parameters(), lr=recipe.learning_rate)
    order = torch.Generator().manual_seed(seed)
    history: list[Epoch] = []
    progress.expect(epochs)
    best, kept = 0, _copied(task.network)
    for number in range(1, epochs + 1):
        started = time.perf_counter()
        train_loss = pass_over(task, optimizer, train, recipe.batch_size, order)
        valid_loss = _mean_loss(task, valid)
        _check_loss(number, train_loss, valid_loss)
        history.append(Epoch(number, train_loss, valid_loss, time.perf_counter() - started))
        if best == 0 or valid_loss < history[best - 1].valid_loss:
            best, kept = number, _copied(task.network)
        progress.done(note=f"loss {valid_loss:.4g}")
        if number - best >= recipe.patience:
            break
    progress.end("ended early")
    task.network.load_state_dict(kept)
    return tuple(history), best


def pass_over(
    task: Task, optimizer: torch.optim.Optimizer, data: Batches, size: int, order: torch.Generator
) -> float:
    """One epoch of steps in random order; its mean loss."""
    task.network.train()
    total: Tensor | float = 0.0  # read once, so that CUDA need not wait
    for batch in data.shuffled(size, order):
        optimizer.zero_grad()
        loss = task.loss(batch)
        torch.autograd.backward(loss)
        optimizer.step()
        total = total + loss.detach() * len(batch)
    return float(total) / len(data)


@torch.no_grad()
def _mean_loss(task: Task, data: Batches) -> float:
    task.network.eval()
    total = 0.0
    for batch in data.in_order(VALIDATION_BATCH):
        total += float(task.loss(batch)) * len(batch)
    return total / len(data)


def _copied(network: nn.Module) -> dict[str, Tensor]:
    return {name: tensor.clone() for name, tensor in network.state_dict().items()}


@contextmanager
def _seeded(seed: int, device: torch.device) -> Iterator[None]:
    """Seeds what dropout and initial weights draw from, and puts it back afterwards."""
    devices = [] if device.type == "cpu" else [device.index or 0]
    kind = "cuda" if device.type == "cpu" else device.type
    with torch.random.fork_rng(devices=devices, device_type=kind):
        torch.manual_seed(seed)
        yield


def _check_loss(epoch: int, *losses: float) -> None:
    if not all(math.isfinite(loss) for loss in losses):
        raise ProlearnError(
            f"the loss is no longer a finite number in epoch {epoch}; lower the learning rate."
        )
