"""What is learnt from: a dataset's training split, or fresh scenarios; and crowded ones."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pipeline.dataset.examples import Examples, ExampleSource
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.reading import MEMORY, examples_within
from pipeline.networks.recipes import Recipe
from pipeline.orbit.problem import Problem
from pipeline.progress import SILENT, Progress
from pipeline.scenario import draw
from pipeline.storage.folder import Where


@dataclass(frozen=True)
class FreshDraws:
    """Training scenarios of a family that nobody has planned, others on each pass.

    A part is a pass. There is always another one, though the source is as long as one of them.

    Attributes:
        family: of scenarios.
        seed: root seed.
        n: number of spacecraft in each.
        problem: the problem that they share.
        count: scenarios a pass.
    """

    family: str
    seed: int
    n: int
    problem: Problem
    count: int

    def __len__(self) -> int:
        """Number of scenarios a pass."""
        return self.count

    @property
    def buffer(self) -> int:
        """A pass is held at once."""
        return self.count

    @property
    def part_count(self) -> int:
        """One pass."""
        return 1

    def parts(self, order: Sequence[int] | None = None) -> Iterator[Examples]:
        """The passes of some numbers, or the first."""
        for number in [0] if order is None else order:
            yield _drawn(self, number)


@lru_cache(maxsize=1)  # the first pass is looked at several times
def _drawn(source: FreshDraws, number: int, progress: Progress = SILENT) -> Examples:
    """The scenarios of a pass, whose indices go on from the pass before."""
    first, scenarios = number * source.count, []
    progress.expect(source.count)
    for index in range(first, first + source.count):
        one = draw(source.family, source.seed, source.n, index, source.problem, "train")
        scenarios.append(one)
        progress.done(note=f"{source.family} scenarios drawn")
    initial = np.stack([scenario.initial for scenario in scenarios])
    goal = np.stack([scenario.goal for scenario in scenarios])
    return Examples(source.problem, initial, goal)


@dataclass(frozen=True, eq=False)
class Joined:
    """Scenarios with others after them that nobody has planned.

    Where the first have plans and stand in one part with others, the states of these are not
    numbers.

    Attributes:
        first: in memory or read part by part.
        second: in memory.
    """

    first: ExampleSource
    second: Examples

    @property
    def problem(self) -> Problem:
        """The problem that they share."""
        return self.first.problem

    @property
    def n(self) -> int:
        """Number of spacecraft in each instance."""
        return self.first.n

    @property
    def buffer(self) -> int | None:
        """As of the first."""
        return self.first.buffer

    @property
    def part_count(self) -> int:
        """One part more, or one where all of them are in memory."""
        return 1 if self.buffer is None else self.first.part_count + 1

    def parts(self, order: Sequence[int] | None = None) -> Iterator[Examples]:
        """The parts of the first, and the second as the last one."""
        if self.buffer is None:
            (first,) = self.first.parts()
            yield _together(first, self.second)
            return
        last = self.part_count - 1
        for number in range(self.part_count) if order is None else order:
            yield from [self.second] if number == last else self.first.parts([number])

    def __len__(self) -> int:
        """Number of instances."""
        return len(self.first) + len(self.second)


def _together(first: Examples, second: Examples) -> Examples:
    """Both in one; with states where the first have some."""
    initial = np.concatenate([first.initial, second.initial])
    goal = np.concatenate([first.goal, second.goal])
    states = first.states
    if states is not None:
        none = np.full((len(second), *states.shape[1:]), np.nan)
        states = np.concatenate([states, none])
    return Examples(first.problem, initial, goal, states)


def sources(
    recipe: Recipe,
    data: Where,
    n: int,
    *,
    seed: int,
    memory: float = MEMORY,
    progress: Progress = SILENT,
) -> tuple[ExampleSource, ExampleSource]:
    """What a recipe learns from, and what decides which weights are kept.

    Args:
        recipe: whose ``draws`` say whether it learns from fresh scenarios, drawn like the
            dataset's, instead of the dataset's training split; otherwise ``crowded`` adds some.
        data: a solved dataset; its test split stays untouched.
        n: swarm size.
        seed: of fresh scenarios.
        memory: bytes that each of the two may take; what is larger streams from the dataset.
        progress: told of crowded scenarios as they are drawn.

    Raises:
        InputError: where there is no dataset, the size is not in it, it is not solved, or no
            instance of a split that is needed is.
    """
    if recipe.draws:
        valid = examples_within(data, n, "valid", memory)
        family = read_manifest(data).samples[n].family
        return FreshDraws(family, seed, n, valid.problem, recipe.draws), valid
    learn = examples_within(data, n, "train", memory)
    valid = examples_within(data, n, "valid", memory)
    if not recipe.crowded:
        return learn, valid
    crowded = FreshDraws("dense", seed, n, valid.problem, recipe.crowded)
    return Joined(learn, _drawn(crowded, 0, progress)), valid
