"""Training data: scenarios of a dataset or fresh draws, as tensors, in batches."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import count

import numpy as np
import torch
from torch import Tensor

from pipeline.arrays import Int
from pipeline.dataset.examples import Examples, ExampleSource, ExampleStream
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.reading import MEMORY, solved_examples
from pipeline.errors import InputError
from pipeline.networks.architecture import Architecture, TensorBatch, swarms
from pipeline.networks.encoding import Encoding
from pipeline.networks.recipes import Recipe
from pipeline.orbit.problem import Problem
from pipeline.progress import SILENT, Progress
from pipeline.scenario import draw_many
from pipeline.storage.folder import Where


def fresh_draws(family: str, seed: int, n: int, problem: Problem, count: int) -> ExampleStream:
    """A stream of fresh training scenarios without plans, ``count`` new ones a pass."""

    def read(number: int) -> Examples:
        return _drawn(family, seed, n, problem, range(number * count, (number + 1) * count))

    return ExampleStream(problem, n, count, count, 1, read, endless=True)


DRAWN = 200  # scenarios drawn between reports of progress


@lru_cache(maxsize=1)  # the first pass is looked at several times
def _drawn(
    family: str, seed: int, n: int, problem: Problem, which: range, progress: Progress = SILENT
) -> Examples:
    ends = []
    progress.expect(len(which))
    for some in (which[k : k + DRAWN] for k in range(0, len(which), DRAWN)):
        drawn = draw_many(family, seed, n, [("train", index) for index in some], problem)
        ends += [(one.initial, one.goal) for one in drawn]
        progress.done(len(some), note=f"{family} scenarios drawn")
    return Examples(problem, *map(np.stack, zip(*ends, strict=True)))


def joined(first: ExampleSource, second: Examples) -> ExampleSource:
    """Solved examples, then others without plans: NaN in memory, or the last part of a stream."""
    if isinstance(first, ExampleStream):
        last = first.part_count

        def read(part: int) -> Examples:
            return second if part == last else first.read(part)

        both = len(first) + len(second)
        return replace(first, count=both, part_count=last + 1, read=read)
    assert first.states is not None, "those of a dataset are solved"
    none = np.full((len(second), *first.states.shape[1:]), np.nan)
    return Examples(
        first.problem,
        np.concatenate([first.initial, second.initial]),
        np.concatenate([first.goal, second.goal]),
        np.concatenate([first.states, none]),
    )


def sources(
    recipe: Recipe,
    data: Where,
    n: int,
    *,
    seed: int,
    memory: float = MEMORY,
    progress: Progress = SILENT,
) -> tuple[ExampleSource, ExampleSource]:
    """Training and validation examples of a recipe.

    The recipe's ``draws`` replace the training split of a solved dataset by fresh scenarios, drawn
    like it from the seed, or its ``crowded`` adds some, of which ``progress`` is told; the test
    split stays untouched. Each of the two may take so many bytes of memory; what is larger streams.
    InputError where there is no dataset, the size is not in it, it is not solved, or no instance of
    a split that is needed is.
    """
    manifest = read_manifest(data)
    refuse_orbit(manifest.problem)  # before the draws below, which take minutes
    if recipe.draws:
        valid = solved_examples(data, n, "valid", memory)
        family = manifest.samples[n].family
        return fresh_draws(family, seed, n, valid.problem, recipe.draws), valid
    learn = solved_examples(data, n, "train", memory)
    valid = solved_examples(data, n, "valid", memory)
    if not recipe.crowded:
        return learn, valid
    which = range(recipe.crowded)
    return joined(learn, _drawn("dense", seed, n, valid.problem, which, progress)), valid


@dataclass(frozen=True, eq=False)
class Prepared:
    """Input tensors of an architecture for some examples, all on one device."""

    tensors: TensorBatch

    def __len__(self) -> int:
        return len(next(iter(self.tensors.values())))

    def at(self, rows: Int[Tensor, "b"]) -> "Prepared":
        """Some of them, in any order."""
        # Copies whole instances, where an index in brackets would copy number by number.
        return Prepared({name: t.index_select(0, rows) for name, t in self.tensors.items()})

    def joined(self, other: "Prepared") -> "Prepared":
        """These instances and others after them."""
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


@dataclass(frozen=True)
class Preparation:
    """Preparation of examples as an architecture's input tensors, on a device."""

    architecture: Architecture
    encoding: Encoding
    device: torch.device

    def of(self, examples: Examples) -> Prepared:
        """The examples, prepared, on the device; InputError where it lacks their precision."""
        given = swarms(examples.problem, examples.initial, examples.goal, examples.states)
        batch = self.architecture.prepare(given, self.encoding)
        if self.device.type == "mps" and torch.float64 in {t.dtype for t in batch.values()}:
            raise InputError(
                "device is mps, which has no float64, and this network learns in it; expected cpu "
                "or cuda."
            )
        return Prepared({name: tensor.to(self.device) for name, tensor in batch.items()})


@dataclass(frozen=True, eq=False)
class Streamed:
    """Examples that are prepared part by part as every pass reads or draws them."""

    source: ExampleStream
    preparation: Preparation
    passes: Iterator[int] = field(default_factory=count)  # of an endless source, those to come

    def __len__(self) -> int:
        return len(self.source)

    def shuffled(self, size: int, order: torch.Generator) -> Iterator[Prepared]:
        """Parts in random order, mixed in a buffer of two batches or more."""
        if self.source.endless:
            yield from self.preparation.of(self.source.read(next(self.passes))).in_order(size)
            return
        full = max(self.source.buffer, 2 * size)
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


Batches = Prepared | Streamed


def batches(source: ExampleSource, preparation: Preparation) -> Batches:
    """Examples that are in memory, prepared once; others, prepared as they are read or drawn."""
    if isinstance(source, ExampleStream):
        return Streamed(source, preparation)
    return preparation.of(source)


def refuse_orbit(problem: Problem) -> None:
    """Refuse training data about another orbit than a circle with an InputError."""
    if problem.orbit is not None:
        raise InputError(
            "the training examples are about a reference orbit with eccentricity or perturbations; "
            "expected a circle: the refiner plans about any orbit without being trained there."
        )


def check_examples(train: ExampleSource, valid: ExampleSource) -> None:
    """Refuse examples that are empty, not finite, or of different n or problems (InputError)."""
    for name, source in (("training", train), ("validation", valid)):
        if len(source) == 0:
            raise InputError(f"there are no {name} examples; expected at least one: add more data.")
        first = 0
        for examples in source.parts():
            _check_finite(examples, name, first)
            first += len(examples)
    refuse_orbit(train.problem)
    if (valid.n, valid.problem) != (train.n, train.problem):
        raise InputError(
            f"validation examples have n = {valid.n} and {valid.problem}; expected those of the "
            f"training examples, n = {train.n} and {train.problem}."
        )


def _check_finite(examples: Examples, name: str, first: int) -> None:
    for column in ("initial", "goal", "states"):
        values = getattr(examples, column)
        if values is None:
            continue
        flat = values.reshape(len(examples), -1)
        bad = ~np.isfinite(flat).all(axis=1)
        if column == "states":
            bad &= ~np.isnan(flat).all(axis=1)  # nobody has planned these
        if bad.any():
            raise InputError(
                f"{name} example {first + bad.argmax()} has {column} that are not finite numbers; "
                "verify the dataset or make it again."
            )
