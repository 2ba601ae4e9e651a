"""Training data: scenarios of a dataset or fresh draws, as tensors, in batches."""

from collections.abc import Callable, Iterator
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


DRAWN_AT_ONCE = 200  # scenarios drawn between reports of progress


@lru_cache(maxsize=1)  # the first pass is read several times
def _drawn(
    family: str, seed: int, n: int, problem: Problem, indices: range, progress: Progress = SILENT
) -> Examples:
    ends = []
    progress.expect(len(indices))
    for k in range(0, len(indices), DRAWN_AT_ONCE):
        batch = [("train", index) for index in indices[k : k + DRAWN_AT_ONCE]]
        drawn = draw_many(family, seed, n, batch, problem)
        ends += [(scenario.initial, scenario.goal) for scenario in drawn]
        progress.done(len(batch), note=f"{family} scenarios drawn")
    return Examples(problem, *map(np.stack, zip(*ends, strict=True)))


def joined(first: ExampleSource, second: Examples) -> ExampleSource:
    """Solved examples, then others without plans: as NaN in memory, or as a stream's last part."""
    if isinstance(first, ExampleStream):
        last = first.part_count

        def read(part: int) -> Examples:
            return second if part == last else first.read(part)

        count = len(first) + len(second)
        return replace(first, count=count, part_count=last + 1, read=read)
    assert first.states is not None, "examples of a dataset are solved"
    unplanned = np.full((len(second), *first.states.shape[1:]), np.nan)
    return Examples(
        first.problem,
        np.concatenate([first.initial, second.initial]),
        np.concatenate([first.goal, second.goal]),
        np.concatenate([first.states, unplanned]),
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

    The recipe's ``draws`` replace the training split of a solved dataset by fresh scenarios of its
    family, drawn from the seed; ``crowded`` adds dense ones, whose draws ``progress`` reports. The
    test split stays untouched. Either source may take ``memory`` bytes; a larger one is streamed.
    InputError where there is no dataset, it lacks the size, or a split that is needed has no solved
    instance.
    """
    manifest = read_manifest(data)
    refuse_other_orbits(manifest.problem)  # before the draws below, which take minutes
    if recipe.draws:
        valid = solved_examples(data, n, "valid", memory)
        family = manifest.samples[n].family
        return fresh_draws(family, seed, n, valid.problem, recipe.draws), valid
    train = solved_examples(data, n, "train", memory)
    valid = solved_examples(data, n, "valid", memory)
    if not recipe.crowded:
        return train, valid
    indices = range(recipe.crowded)
    return joined(train, _drawn("dense", seed, n, valid.problem, indices, progress)), valid


@dataclass(frozen=True, eq=False)
class Prepared:
    """Input tensors of an architecture for some examples, all on one device."""

    tensors: TensorBatch

    def __len__(self) -> int:
        return len(next(iter(self.tensors.values())))

    def at(self, rows: Int[Tensor, "b"]) -> "Prepared":
        """Some examples, in any order."""
        # Copies whole instances, while an index in brackets would copy number by number.
        return Prepared({name: t.index_select(0, rows) for name, t in self.tensors.items()})

    def joined(self, other: "Prepared") -> "Prepared":
        """These examples and others after them."""
        return Prepared({k: torch.cat([t, other.tensors[k]]) for k, t in self.tensors.items()})

    def random_rows(self, order: torch.Generator) -> Int[Tensor, "b"]:
        """The numbers of all examples in random order, on their device."""
        device = next(iter(self.tensors.values())).device
        return torch.randperm(len(self), generator=order).to(device)

    def shuffled(self, size: int, order: torch.Generator) -> Iterator["Prepared"]:
        """All examples once, in random batches."""
        return (self.at(part) for part in torch.split(self.random_rows(order), size))

    def in_order(self, size: int) -> Iterator["Prepared"]:
        """All examples once, in batches."""
        for k in range(0, len(self), size):
            yield Prepared({name: t[k : k + size] for name, t in self.tensors.items()})


Prepare = Callable[[Examples], Prepared]


def prepare(
    architecture: Architecture, encoding: Encoding, device: torch.device, examples: Examples
) -> Prepared:
    """Examples as an architecture's input tensors; InputError where a device lacks float64."""
    batch = swarms(examples.problem, examples.initial, examples.goal, examples.states)
    tensors = architecture.prepare(batch, encoding)
    if device.type == "mps" and torch.float64 in {t.dtype for t in tensors.values()}:
        raise InputError(
            "device is mps, which has no float64, and this network is trained in float64; "
            "expected cpu or cuda."
        )
    return Prepared({name: tensor.to(device) for name, tensor in tensors.items()})


@dataclass(frozen=True, eq=False)
class Streamed:
    """Examples that each pass reads or draws, and prepares, part by part."""

    source: ExampleStream
    prepare: Prepare
    passes: Iterator[int] = field(default_factory=count)  # next parts of an endless source

    def __len__(self) -> int:
        return len(self.source)

    def shuffled(self, size: int, order: torch.Generator) -> Iterator[Prepared]:
        """Parts in random order, mixed in a buffer of two batches or more."""
        if self.source.endless:
            yield from self.prepare(self.source.read(next(self.passes))).in_order(size)
            return
        full = max(self.source.buffer, 2 * size)
        parts = torch.randperm(self.source.part_count, generator=order).tolist()
        held: Prepared | None = None
        for examples in self.source.parts(parts):
            part = self.prepare(examples)
            held = part if held is None else held.joined(part)
            if len(held) >= full:
                rows = held.random_rows(order)
                out = len(held) // 2 // size * size
                yield from (held.at(batch) for batch in torch.split(rows[:out], size))
                held = held.at(rows[out:])
        if held is not None:
            yield from held.shuffled(size, order)

    def in_order(self, size: int) -> Iterator[Prepared]:
        """All examples once, in batches that each lie in one part."""
        for examples in self.source.parts():
            yield from self.prepare(examples).in_order(size)


Batches = Prepared | Streamed


def batches(source: ExampleSource, prepare: Prepare) -> Batches:
    """Examples in memory, prepared once; or a stream's, prepared as they are read or drawn."""
    return Streamed(source, prepare) if isinstance(source, ExampleStream) else prepare(source)


def refuse_other_orbits(problem: Problem) -> None:
    """Raise InputError for training data about any reference orbit but a circle."""
    if problem.orbit is not None:
        raise InputError(
            "the training examples are about a reference orbit with eccentricity or perturbations; "
            "expected a circle: the refiner plans about any orbit without being trained there."
        )


def check_examples(train: ExampleSource, valid: ExampleSource) -> None:
    """Raise InputError for examples that are none, not finite, or of different n or problems."""
    for name, source in (("training", train), ("validation", valid)):
        if len(source) == 0:
            raise InputError(f"there are no {name} examples; expected at least one: add more data.")
        first = 0
        for examples in source.parts():
            _check_finite(examples, name, first)
            first += len(examples)
    refuse_other_orbits(train.problem)
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
            bad &= ~np.isnan(flat).all(axis=1)  # examples without a plan
        if bad.any():
            raise InputError(
                f"{name} example {first + bad.argmax()} has {column} that are not finite numbers; "
                "verify the dataset or make it again."
            )
