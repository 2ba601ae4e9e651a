"""The training loop: steps on shuffled batches, the best weights on validation kept."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.dataset.examples import ExampleSource
from pipeline.errors import InputError, ProlearnError
from pipeline.networks.architecture import Architecture, find
from pipeline.networks.encoding import Encoding, fit
from pipeline.networks.model import Model
from pipeline.networks.recipes import Recipe
from pipeline.progress import SILENT, Progress
from pipeline.training.data import Batches, Preparation, Prepared, batches, check_examples
from pipeline.training.descent import Descent
from pipeline.training.device import training_device

VALIDATION_BATCH = 256
"""Instances whose validation score is computed at once."""


@dataclass(frozen=True)
class Epoch:
    """One pass over the training data.

    Attributes:
        number: from 1.
        train_loss: mean loss of the pass, with dropout, while the weights change.
        valid_loss: the architecture's score on the validation data after it, least best.
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
        best_epoch: number of the epoch with the least validation score.
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
    """A network and what it is to make small.

    Attributes:
        architecture: whose loss and score it is.
        network: what is trained, on the device of the batches.
        encoding: what the batches are in.
        recipe: how it is trained.
    """

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
            told = (batch.tensors, self.encoding, self.recipe)
            total += float(self.architecture.score(self.network, *told)) * len(batch)
        return total / len(data)


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
        train: what it learns from, in memory, a stream or fresh draws; its n and problem become
            the model's.
        valid: what decides when to stop and which weights to keep.
        seed: of initial weights, order and dropout.
        device: "auto", "cpu", "cuda" or "mps".
        epochs: most passes over the data, instead of the recipe's.
        progress: told of each epoch.

    Raises:
        InputError: for an unknown architecture or device, or examples that cannot be used.
        ProlearnError: where loss or score cease to be finite numbers.
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
        task = Task(architecture, network, encoding, recipe)
        preparation = Preparation(architecture, encoding, where)
        data = batches(train, preparation), batches(valid, preparation)
        history, best = _improve(task, *data, most, seed, progress)
    model = Model(arch, architecture.config, recipe.name, encoding, network.cpu())
    seconds = time.perf_counter() - started
    return Trained(model, history, best, seconds, str(where), torch.get_num_threads())


def _improve(
    task: Task, train: Batches, valid: Batches, epochs: int, seed: int, progress: Progress
) -> tuple[tuple[Epoch, ...], int]:
    """All epochs and the number of the best, whose weights the network is left with."""
    recipe = task.recipe
    descent = Descent(task.network, recipe, epochs * math.ceil(len(train) / recipe.batch_size))
    scored = replace(task, network=descent.result)
    order = torch.Generator().manual_seed(seed)
    history: list[Epoch] = []
    progress.expect(epochs)
    best, kept = 0, _copied(scored.network)
    for number in range(1, epochs + 1):
        started = time.perf_counter()
        train_loss = pass_over(task, descent, train, order)
        valid_loss = scored.score(valid)
        _check_loss(number, train_loss, valid_loss)
        history.append(Epoch(number, train_loss, valid_loss, time.perf_counter() - started))
        if best == 0 or valid_loss < history[best - 1].valid_loss:
            best, kept = number, _copied(scored.network)
        progress.done(note=f"loss {valid_loss:.4g}")
        if number - best >= recipe.patience:
            break
    progress.end("ended early")
    task.network.load_state_dict(kept)
    return tuple(history), best


def pass_over(task: Task, descent: Descent, data: Batches, order: torch.Generator) -> float:
    """One epoch of steps in random order; its mean loss."""
    task.network.train()
    total: Tensor | float = 0.0  # read once, so that CUDA need not wait
    for batch in data.shuffled(task.recipe.batch_size, order):
        loss = task.loss(batch)
        descent.step(loss)
        total = total + loss.detach() * len(batch)
    return float(total) / len(data)


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
