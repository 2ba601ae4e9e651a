"""Training examples: scenarios as arrays, with the expert's plans where there are any."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.orbit.problem import Problem


@runtime_checkable
class ExampleSource(Protocol):
    """Examples of one problem and swarm size, in memory or read part by part."""

    @property
    def problem(self) -> Problem:
        """The problem that they share."""

    @property
    def n(self) -> int:
        """Number of spacecraft in each example."""

    @property
    def buffer(self) -> int | None:
        """Examples that may be held at once, or None where all of them are in memory."""

    @property
    def part_count(self) -> int:
        """Number of parts."""

    def parts(self, order: Sequence[int] | None = None) -> Iterator["Examples"]:
        """All examples, part by part, in an order of the parts."""

    def __len__(self) -> int:
        """Number of examples."""


@dataclass(frozen=True, eq=False)
class Examples:
    """Examples in memory, which are one part; an ``ExampleSource``. States are in m and m/s."""

    problem: Problem
    initial: Float[Array, "N n 6"]
    goal: Float[Array, "N n 6"]
    # the expert's at the nodes; NaN where it has no plan, None where nobody needs them
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
