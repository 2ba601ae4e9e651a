"""Closest points of relative motions to the origin, by compiled code (``closest.c``)."""

import ctypes
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from pipeline.arrays import Array, CompiledLibrary, Float, Int, Shaped
from pipeline.orbit.arrays import AnyState, Interval, Scalar, Vector, norm

LIBRARY = CompiledLibrary(
    Path(__file__).with_suffix(".c"),
    {
        "closest_of_motions": "pirrdqddp",
        "closest_of_cubics": "irrdddddddd",
        "closest_of_pairs": "piiiiirrqqdddddp",
    },
)

FOUND = np.dtype(
    [
        ("index", np.int64),  # of the motion
        ("offset", np.float64),  # when it is closest, s from the interval's start
        ("distance", np.float64),  # how close it is then, m
        ("bound", np.float64),  # proven lower bound on its distance in the interval, m
        ("state_map", np.float64, (3, 6)),  # from the state at the start to the position then
        ("control_map", np.float64, (3, 3)),  # from the control to it
    ]
)
"""What is found of a motion."""

ROOM = 200_000  # for what is found at once, most of which is never touched


class _LinearMotion(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in ("intervals", "pieces", "rows")),
        *((name, ctypes.c_void_p) for name in ("series", "fourth")),
        ("half", ctypes.c_double),
        ("absolute", ctypes.c_int32),
    )


@dataclass(frozen=True, eq=False)
class LinearMotion:
    """Linear motion in K intervals of constant control; K is 1 where it is the same in all.

    The state in an interval is a polynomial in each of M pieces of it.
    """

    half: float  # of a piece's length, s
    # Chebyshev coefficients, in each piece, of A and B, side by side, from the interval's start
    series: Float[Array, "K M q 6 9"]
    # Maps from state and control to vectors at least as long as the fourth derivative, m/s⁴
    fourth: Float[Array, "K rows 9"]
    absolute: bool  # whether these are for absolute values of state and control

    def __post_init__(self) -> None:
        for name in ("series", "fourth"):
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name)))

    def fourth_derivative_bound(
        self, start: AnyState, control: Vector, interval: Interval
    ) -> Scalar:
        """Upper bound on ‖p⁗‖ in an interval, m/s⁴, for the error of a cubic interpolant."""
        given = np.concatenate([start, control], axis=-1)
        maps = self.fourth[interval if len(self.fourth) > 1 else 0]
        return np.asarray(norm(np.matvec(maps, np.abs(given) if self.absolute else given)))

    @cached_property
    def compiled(self) -> ctypes.Structure:
        """The same for compiled code, valid while this exists."""
        (intervals, pieces, *_), rows = self.series.shape, self.fourth.shape[1]
        at = self.series.ctypes.data, self.fourth.ctypes.data
        return _LinearMotion(intervals, pieces, rows, *at, self.half, self.absolute)


def closest_of_motions(
    motion: LinearMotion,
    given: Float[Array, "k 9"],
    interval: Int[Array, "k"],
    h: float,
    scale: Float[Array, "k 3"] | None,
    within: Float[Array, "k"],
    tolerance: float,
) -> Shaped[Array, "near"]:
    """Closest points of motions over h s that may come within a distance, m, as FOUND.

    Motions are states and controls at the starts of intervals, m, m/s and m/s². Distances are
    measured in axes with a scale of at most 1; bounds are up to a tolerance, m, below them.
    """
    found = np.empty(len(given), FOUND)
    over = ctypes.byref(motion.compiled), len(given), h, tolerance
    where = given, interval, scale, within
    count = LIBRARY.call("closest_of_motions", *over, *where, found.ctypes.data)
    return found[:count].copy()


def closest_of_pairs(
    motion: LinearMotion,
    pairs: tuple[Int[Array, "p"], Int[Array, "p"]],
    flown: Float[Array, "n intervals 15"],
    sag: Float[Array, "n intervals"],
    scale: Float[Array, "p 3"] | None,
    within: Float[Array, "p"],
    h: float,
    tolerance: float,
) -> Shaped[Array, "near"]:
    """As ``closest_of_motions``, of pairs of craft in all intervals of h s.

    Flown are states at the end and at the start of each interval, and controls. In an interval a
    craft stays within ``sag``, m, of uniform motion along its chord. An index is that of the
    interval times the number of pairs, and that of the pair.
    """
    count, (n, intervals, _) = len(within), flown.shape
    together, balls, parts = max(1, ROOM // max(1, count)), np.empty((n, 5)), []
    for begin in range(0, intervals, together):
        end = min(begin + together, intervals)
        found = np.empty(count * (end - begin), FOUND)
        over = ctypes.byref(motion.compiled), n, count, intervals, begin, end, h, tolerance
        where = *pairs, flown, sag, scale, within, balls
        near = LIBRARY.call("closest_of_pairs", *over, *where, found.ctypes.data)
        parts.append(found[:near].copy())
        parts[-1]["index"] += begin * count
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def closest_of_cubics(
    ends: tuple[Float[Array, "k 6"], Float[Array, "k 6"]],
    h: float,
    scale: Float[Array, "k 3"] | None,
    remainder: Float[Array, "k"],
    within: Float[Array, "k"],
    tolerance: float,
) -> tuple[Float[Array, "k"], Float[Array, "k"], Float[Array, "k"]]:
    """When cubics are closest, as a share of h s, how close, and a lower bound on that, m.

    They have the states of both ends, and motions differ from them by up to their remainders, m.
    Bounds are up to that and a tolerance, m, below distances, and infinite beyond ``within``, m.
    """
    found = when, distance, bound = np.empty((3, len(within)))
    given = *ends, scale, remainder, within
    LIBRARY.call("closest_of_cubics", len(within), h, tolerance, *given, *found)
    return when, distance, bound
