"""Training examples: scenarios as arrays, with the expert's plans where there are any."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from pipeline.arrays import Array, Float
from pipeline.orbit.problem import Problem


@dataclass(frozen=True, eq=False)
class Examples:
    """Examples in memory, which are one part. States are in m and m/s."""

    problem: Problem
    initial: Float[Array, "N n 6"]
    goal: Float[Array, "N n 6"]
    # the expert's node states; NaN where it has no plan, None without any
    states: Float[Array, "N n T 6"] | None = None
    buffer = None
    part_count = 1

    def __len__(self) -> int:
        return len(self.initial)

    @property
    def n(self) -> int:
        """Number of spacecraft in each example."""
        return self.initial.shape[1]

    def parts(self, order: Sequence[int] | None = None) -> Iterator["Examples"]:
        """The examples themselves, the only part."""
        yield self


@dataclass(frozen=True)
class ExampleStream:
    """Examples of one problem and swarm size that are read or drawn anew, by parts, each pass."""

    problem: Problem
    n: int  # spacecraft in each example
    count: int  # examples in a pass
    buffer: int  # examples that may be held at once, besides the part that is being read
    part_count: int  # parts in a pass
    read: Callable[[int], Examples]  # gives the part of a number
    endless: bool = False  # whether each pass gets one new part, numbered on

    def __len__(self) -> int:
        return self.count

    def parts(self, order: Sequence[int] | None = None) -> Iterator[Examples]:
        """All examples, part by part, in the given order of the parts or their own."""
        return map(self.read, range(self.part_count) if order is None else order)


ExampleSource = Examples | ExampleStream
