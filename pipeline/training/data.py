"""Examples on their way into training: checked, encoded, on the device, in batches."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.dataset.reading.examples import Examples, ExampleSource
from pipeline.errors import InputError
from pipeline.networks.encoding import Encoding


@dataclass(frozen=True, eq=False)
class Encoded:
    """Examples as a network reads them, float32, all on one device.

    Attributes:
        inputs: what it reads.
        target: what it should answer.
    """

    inputs: Float[Tensor, "N n T 6"]
    target: Float[Tensor, "N n T 6"]

    def __len__(self) -> int:
        """Number of instances."""
        return len(self.inputs)

    def at(self, rows: Int[Tensor, "b"]) -> "Encoded":
        """Some of them, in any order."""
        # Copies whole instances, where an index in brackets would copy number by number.
        return Encoded(self.inputs.index_select(0, rows), self.target.index_select(0, rows))

    def shuffled(self, size: int, order: torch.Generator) -> Iterator["Encoded"]:
        """All of them once, in random batches."""
        rows = torch.randperm(len(self), generator=order).to(self.inputs.device)
        return (self.at(part) for part in torch.split(rows, size))

    def in_order(self, size: int) -> Iterator["Encoded"]:
        """All of them once, in batches."""
        for k in range(0, len(self), size):
            yield Encoded(self.inputs[k : k + size], self.target[k : k + size])


@runtime_checkable
class Batches(Protocol):
    """Encoded examples, batch by batch, as often as they are asked for."""

    def __len__(self) -> int:
        """Number of instances."""
        ...

    def shuffled(self, size: int, order: torch.Generator) -> Iterator[Encoded]:
        """All of them once, in random batches."""
        ...

    def in_order(self, size: int) -> Iterator[Encoded]:
        """All of them once, in batches."""
        ...


@dataclass(frozen=True, eq=False)
class Streamed:
    """Examples that are read and encoded part by part on every pass.

    Attributes:
        source: where they come from.
        encoding: how a network reads them.
        device: where it does.
        buffer: instances among which they are shuffled, two batches at least; a part may come
            on top.
    """

    source: ExampleSource
    encoding: Encoding
    device: torch.device
    buffer: int

    def __len__(self) -> int:
        """Number of instances."""
        return len(self.source)

    def shuffled(self, size: int, order: torch.Generator) -> Iterator[Encoded]:
        """Parts in random order go through a buffer that gives out half of itself at random."""
        full = max(self.buffer, 2 * size)
        parts = torch.randperm(self.source.part_count, generator=order).tolist()
        held: Encoded | None = None
        for examples in self.source.parts(parts):
            part = encoded(examples, self.encoding, self.device)
            held = part if held is None else _joined(held, part)
            if len(held) >= full:
                rows = torch.randperm(len(held), generator=order).to(self.device)
                out = len(held) // 2 // size * size
                yield from (held.at(batch) for batch in torch.split(rows[:out], size))
                held = held.at(rows[out:])
        if held is not None:
            yield from held.shuffled(size, order)

    def in_order(self, size: int) -> Iterator[Encoded]:
        """All of them once, in batches that end with each part."""
        for examples in self.source.parts():
            yield from encoded(examples, self.encoding, self.device).in_order(size)


def encoded(examples: Examples, encoding: Encoding, device: torch.device) -> Encoded:
    """The examples, encoded, on a device."""
    inputs = encoding.inputs(examples.initial, examples.goal)
    target = encoding.targets(examples.states, inputs)
    return Encoded(inputs.float().to(device), target.float().to(device))


def batches(source: ExampleSource, encoding: Encoding, device: torch.device) -> Batches:
    """Examples that are in memory, encoded once; others, encoded as they are read."""
    if source.buffer is not None:
        return Streamed(source, encoding, device, source.buffer)
    (examples,) = source.parts()
    return encoded(examples, encoding, device)


def check_examples(train: ExampleSource, valid: ExampleSource) -> None:
    """Refuse examples that nothing can be learnt from.

    Raises:
        InputError: where either is empty or holds values that are not finite numbers, or where
            the two differ in swarm size or problem.
    """
    for name, source in (("training", train), ("validation", valid)):
        if len(source) == 0:
            raise InputError(f"there are no {name} examples; expected at least one: add more data.")
        first = 0
        for examples in source.parts():
            _check_finite(examples, name, first)
            first += len(examples)
    if (valid.n, valid.problem) != (train.n, train.problem):
        raise InputError(
            f"validation examples have n = {valid.n} and {valid.problem}; expected those of the "
            f"training examples, n = {train.n} and {train.problem}."
        )


def _check_finite(examples: Examples, name: str, first: int) -> None:
    for field in ("initial", "goal", "states"):
        values = getattr(examples, field)
        if np.isfinite(values).all():
            continue
        bad = ~np.isfinite(values).reshape(len(examples), -1).all(axis=1)
        raise InputError(
            f"{name} example {first + bad.argmax()} has {field} that are not finite numbers; "
            "verify the dataset or make it again."
        )


def _joined(one: Encoded, other: Encoded) -> Encoded:
    return Encoded(torch.cat([one.inputs, other.inputs]), torch.cat([one.target, other.target]))
