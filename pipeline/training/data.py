"""Examples on their way into training: checked, prepared, on the device, in batches."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from pipeline.dataset.examples import Examples, ExampleSource
from pipeline.errors import InputError
from pipeline.networks.architecture import Architecture
from pipeline.networks.encoding import Encoding
from pipeline.networks.swarms import Batch, swarms
from pipeline.training.sources import FreshDraws


@dataclass(frozen=True, eq=False)
class Prepared:
    """Examples as an architecture has prepared them, all on one device.

    Attributes:
        tensors: by the architecture's names; their first axis is that of the instances.
    """

    tensors: Batch

    def __len__(self) -> int:
        """Number of instances."""
        return len(next(iter(self.tensors.values())))

    def at(self, rows: Int[Tensor, "b"]) -> "Prepared":
        """Some of them, in any order."""
        # Copies whole instances, where an index in brackets would copy number by number.
        return Prepared({name: t.index_select(0, rows) for name, t in self.tensors.items()})

    def joined(self, other: "Prepared") -> "Prepared":
        """These and others after them."""
        return Prepared({k: torch.cat([t, other.tensors[k]]) for k, t in self.tensors.items()})

    def shuffled(self, size: int, order: torch.Generator) -> Iterator["Prepared"]:
        """All of them once, in random batches."""
        device = next(iter(self.tensors.values())).device
        rows = torch.randperm(len(self), generator=order).to(device)
        return (self.at(part) for part in torch.split(rows, size))

    def in_order(self, size: int) -> Iterator["Prepared"]:
        """All of them once, in batches."""
        for k in range(0, len(self), size):
            yield Prepared({name: t[k : k + size] for name, t in self.tensors.items()})


@runtime_checkable
class Batches(Protocol):
    """Prepared examples, batch by batch, as often as they are asked for."""

    def __len__(self) -> int:
        """Number of instances."""
        ...

    def shuffled(self, size: int, order: torch.Generator) -> Iterator[Prepared]:
        """All of them once, in random batches."""
        ...

    def in_order(self, size: int) -> Iterator[Prepared]:
        """All of them once, in batches."""
        ...


@dataclass(frozen=True)
class Preparation:
    """How examples become what a network reads.

    Attributes:
        architecture: whose network it is.
        encoding: the units that it reads and answers in.
        device: where it is.
    """

    architecture: Architecture
    encoding: Encoding
    device: torch.device

    def of(self, examples: Examples) -> Prepared:
        """The examples, prepared, on the device."""
        given = swarms(examples.problem, examples.initial, examples.goal, examples.states)
        batch = self.architecture.prepare(given, self.encoding)
        return Prepared({name: tensor.to(self.device) for name, tensor in batch.items()})


@dataclass(frozen=True, eq=False)
class Streamed:
    """Examples that are read and prepared part by part on every pass.

    Attributes:
        source: where they come from.
        preparation: how a network reads them.
        buffer: instances among which they are shuffled, two batches at least; a part may come
            on top.
    """

    source: ExampleSource
    preparation: Preparation
    buffer: int

    def __len__(self) -> int:
        """Number of instances."""
        return len(self.source)

    def shuffled(self, size: int, order: torch.Generator) -> Iterator[Prepared]:
        """Parts in random order go through a buffer that gives out half of itself at random."""
        full = max(self.buffer, 2 * size)
        parts = torch.randperm(self.source.part_count, generator=order).tolist()
        held: Prepared | None = None
        for examples in self.source.parts(parts):
            part = self.preparation.of(examples)
            held = part if held is None else held.joined(part)
            if len(held) >= full:
                rows = torch.randperm(len(held), generator=order).to(self.preparation.device)
                out = len(held) // 2 // size * size
                yield from (held.at(batch) for batch in torch.split(rows[:out], size))
                held = held.at(rows[out:])
        if held is not None:
            yield from held.shuffled(size, order)

    def in_order(self, size: int) -> Iterator[Prepared]:
        """All of them once, in batches that end with each part."""
        for examples in self.source.parts():
            yield from self.preparation.of(examples).in_order(size)


@dataclass(frozen=True, eq=False)
class Drawn(Streamed):
    """Scenarios of which every pass draws others, so that there is nothing to shuffle."""

    passes: Iterator[int] = field(default_factory=count)

    def shuffled(self, size: int, order: torch.Generator) -> Iterator[Prepared]:
        """The next pass, in batches."""
        for examples in self.source.parts([next(self.passes)]):
            yield from self.preparation.of(examples).in_order(size)


def batches(source: ExampleSource, preparation: Preparation) -> Batches:
    """Examples that are in memory, prepared once; others, prepared as they are read or drawn."""
    if isinstance(source, FreshDraws):
        return Drawn(source, preparation, source.buffer)
    if source.buffer is not None:
        return Streamed(source, preparation, source.buffer)
    (examples,) = source.parts()
    return preparation.of(examples)


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
    for column in ("initial", "goal", "states"):
        values = getattr(examples, column)
        if values is None or np.isfinite(values).all():
            continue
        flat = values.reshape(len(examples), -1)
        bad = ~np.isfinite(flat).all(axis=1)
        if column == "states":
            bad &= ~np.isnan(flat).all(axis=1)  # nobody has planned these
        if not bad.any():
            continue
        raise InputError(
            f"{name} example {first + bad.argmax()} has {column} that are not finite numbers; "
            "verify the dataset or make it again."
        )
