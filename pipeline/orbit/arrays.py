"""Array types of relative motion: LVLH frame (x radial, y along-track, z cross-track), SI units.

A state is x y z vx vy vz in m and m/s, a control is an acceleration in m/s², constant over an
interval. n craft, T nodes, T-1 intervals.
"""

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np

from pipeline.arrays import Array, Bool, Float, Int, namespace

Formation = Float[Array, "n 6"]
States = Float[Array, "n T 6"]
Controls = Float[Array, "n intervals 3"]
PerCraft = Float[Array, "n"]  # a value of each of n craft
CraftMask = Bool[Array, "n"]  # which of n craft

AnyState = Float[Array, "*batch 6"]
AnyStates = Float[Array, "*batch T 6"]
AnyControls = Float[Array, "*batch intervals 3"]
Vector = Float[Array, "*batch 3"]
Scalar = Float[Array, "*batch"]

Indices = Int[Array, "k"]
Values = Float[Array, "k"]
# Position rows of A and B of Eq. 2: from k states at starts of intervals, and controls in them
PositionMaps = tuple[Float[Array, "k 3 6"], Float[Array, "k 3 3"]]
StepMaps = tuple[Float[Array, "*all 6 6"], Float[Array, "*all 6 3"]]  # A and B of Eq. 2
Vectors = Float[Array, "k 3"]  # of k pairs, times or the like
# Numbers of intervals or nodes, counted from a plan's first; they broadcast against times
Interval = int | Int[Array, "*some"]
Node = int | Int[Array, "*others"]
Since = float | Float[Array, "*some"]  # s since an interval's start


def mapped(
    maps: Float[Array, "*steps i j"], rows: Float[Array, "*batch j"]
) -> Float[Array, "*all i"]:
    """Apply to each row the one matrix, or that of its interval."""
    return rows @ maps.T if maps.ndim == 2 else np.matvec(maps, rows)


def norm(a: Float[Any, "*batch d"]) -> Float[Any, "*batch"]:
    """Euclidean norm along the last axis of an array or tensor."""
    if isinstance(a, np.ndarray):
        return np.sqrt(np.vecdot(a, a))
    return namespace(a).linalg.vector_norm(a, dim=-1)


SomeRows = TypeVar("SomeRows", bound="Rows")


class Rows:
    """Base of dataclasses of arrays with the same number of rows; a field may also be None."""

    def __len__(self) -> int:
        return len(next(iter(vars(self).values())))

    def __getitem__(self: SomeRows, which: Any) -> SomeRows:
        """Some of the rows, by a mask, indices or a slice."""
        if isinstance(which, np.ndarray):  # numpy takes rows by number fastest
            which = which if which.dtype != bool else which.nonzero()[0]
            return type(self)(
                *[
                    v.take(which, 0) if isinstance(v, np.ndarray) else v and v[which]
                    for v in vars(self).values()
                ]
            )
        return type(self)(*[v if v is None else v[which] for v in vars(self).values()])

    @classmethod
    def concatenated(cls: type[SomeRows], parts: Sequence[SomeRows]) -> SomeRows:
        """The rows of all parts, one after the other."""
        return cls(*map(_concatenated, zip(*(vars(part).values() for part in parts), strict=True)))


def _concatenated(values: Sequence[Any]) -> Any:
    first = values[0]
    if isinstance(first, Rows):
        return first.concatenated(values)
    return None if first is None else np.concatenate(values)
