"""Corridors: boxes and approach cones that craft stay inside of for some time, and proof of it.

Each is an intersection of half-spaces, a · p ≤ b. Along a normal the motion on a stretch of length
h is a cubic up to h⁴/384 max|p⁗|, and the largest value of a cubic is at an end or at a root of its
derivative: so every stretch has a proven bound, and nothing is sampled.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from reprlib import repr as brief

import numpy as np

from pipeline.arrays import Array, Bool, Float, fields_as_python
from pipeline.errors import InputError, check_finite, check_kind, check_vector, is_whole
from pipeline.orbit.approaches import TOLERANCE
from pipeline.orbit.arrays import Controls, CraftMask, Indices, Rows, States, Values, Vectors
from pipeline.orbit.chebyshev import COEFFICIENTS, CUBICS, basis, derivative_bound
from pipeline.orbit.nearest import Nearest, no_pairs
from pipeline.orbit.partition import least_of_each
from pipeline.orbit.problem import Problem

MOST_CORRIDORS = 500  # of a scenario: every face of each is looked at for every craft
SIDES = 16  # of the pyramid inscribed in an approach cone; its inradius is 98 % of the cone's
MOST_NARROWED = 0.9  # largest share of its width by which a box is made narrower
# Half-angle of a cone, deg; sides of narrower ones are lost in rounding
NARROWEST, STEEPEST = 1e-6, 89.0
ROUNDING = 1e-9  # tolerance of times at the ends of an interval, as a share of it

Coordinates = tuple[float, float, float]


def _numbers(vector: Coordinates) -> str:
    """A vector as text, with six digits."""
    return f"({', '.join(f'{one:.6g}' for one in vector)})"


@dataclass(frozen=True)
class Box:
    """A box along the LVLH axes.

    Attributes:
        min: least coordinates, m.
        max: largest coordinates, m.
    """

    min: Coordinates
    max: Coordinates

    def __post_init__(self) -> None:
        fields_as_python(self)
        check_vector("min of a box", self.min)
        check_vector("max of a box", self.max)
        if not all(low < high for low, high in zip(self.min, self.max, strict=True)):
            raise InputError(
                f"a box has min {self.min} and max {self.max}; expected less than max."
            )

    def __str__(self) -> str:
        return f"the box from {_numbers(self.min)} to {_numbers(self.max)} m"

    @property
    def faces(self) -> tuple[Float[Array, "F 3"], Float[Array, "F"]]:
        """Outward normals a and offsets b, m, of a · p ≤ b."""
        axes = np.eye(3)
        return np.concatenate([axes, -axes]), np.array([*self.max, *(-low for low in self.min)])

    def narrower(self, by: float) -> "Box":
        """The box with its faces moved inward by a distance, m, but not until it is empty."""
        low, high = np.array(self.min), np.array(self.max)
        by = np.minimum(by, MOST_NARROWED * (high - low) / 2)
        return Box(*(tuple(one.tolist()) for one in (low + by, high - by)))

    def outline(self) -> Float[Array, "_ 3"]:
        """Points of a line along all edges, for figures, m."""
        ends = np.array([self.min, self.max])
        walk = (0, 1, 3, 2, 0, 4, 5, 1, 5, 7, 3, 7, 6, 2, 6, 4)  # corners, by their bits
        return np.array([[ends[corner >> k & 1, k] for k in range(3)] for corner in walk])


@dataclass(frozen=True)
class Cone:
    """An approach cone; craft stay inside the inscribed pyramid of SIDES sides, which is 16.

    Attributes:
        apex: LVLH, m.
        axis: direction in which it opens, of any length.
        half_angle_deg: between axis and edge, deg.
    """

    apex: Coordinates
    axis: Coordinates
    half_angle_deg: float

    def __post_init__(self) -> None:
        fields_as_python(self)
        check_vector("apex of a cone", self.apex)
        check_vector("axis of a cone", self.axis)
        check_finite("half_angle_deg of a cone", self.half_angle_deg, "degrees")
        if not NARROWEST < self.half_angle_deg <= STEEPEST or not any(self.axis):
            raise InputError(
                f"a cone has the axis {self.axis} and a half-angle of {self.half_angle_deg:g} deg; "
                f"expected a direction and an angle above {NARROWEST:g} and up to {STEEPEST:g} deg."
            )

    @property
    def direction(self) -> Float[Array, "3"]:
        """The unit vector along the axis."""
        return np.array(self.axis) / math.hypot(*self.axis)

    def __str__(self) -> str:
        apex, axis = _numbers(self.apex), _numbers(self.axis)
        return f"the cone from {apex} m along {axis}, half-angle {self.half_angle_deg:g}°"

    @property
    def edges(self) -> Float[Array, "SIDES 3"]:
        """Unit vectors along the edges of the pyramid."""
        axis = self.direction
        across = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        across /= np.linalg.norm(across)
        turn, tilt = 2 * np.pi * np.arange(SIDES) / SIDES, np.deg2rad(self.half_angle_deg)
        round_ = np.outer(np.cos(turn), across) + np.outer(np.sin(turn), np.cross(axis, across))
        return np.cos(tilt) * axis + np.sin(tilt) * round_

    @property
    def faces(self) -> tuple[Float[Array, "F 3"], Float[Array, "F"]]:
        """As ``Box.faces``, of the pyramid."""
        normal = np.cross(np.roll(self.edges, -1, axis=0), self.edges)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return normal, normal @ np.array(self.apex)

    def narrower(self, by: float) -> "Cone":
        """The cone moved along its axis so that its faces are a distance further in, m."""
        axis = self.direction
        apex = np.array(self.apex) - by / (self.faces[0] @ axis).mean() * axis
        return Cone(tuple(apex.tolist()), self.axis, self.half_angle_deg)

    def outline(self, length: float) -> Float[Array, "_ 3"]:
        """As ``Box.outline``, with edges of a length, m."""
        apex = np.array(self.apex)
        ends = apex + length * self.edges
        parts = np.broadcast_to(apex, ends.shape), ends, np.roll(ends, -1, axis=0)
        return np.stack(parts, axis=1).reshape(-1, 3)


@dataclass(frozen=True)
class Corridor:
    """A corridor: a box or an approach cone that craft must stay inside of for some time.

    Attributes:
        inside: the set.
        begin: from when on, s since the first node.
        end: until when, s.
        craft: which craft; all where none is named.
    """

    inside: Box | Cone
    begin: float
    end: float
    craft: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        fields_as_python(self)
        check_kind("inside of a corridor", self.inside, Box | Cone)
        for name in ("begin", "end"):
            check_finite(f"{name} of a corridor", getattr(self, name), "seconds")
        if not isinstance(self.craft, tuple) or not all(map(is_whole, self.craft)):
            raise InputError(f"craft of a corridor is {self.craft!r}; expected craft's numbers.")


def check_corridors(corridors: Sequence[Corridor], n: int, problem: Problem) -> None:
    """Raise InputError for corridors of craft that do not exist or times outside the transfer."""
    if len(corridors) > MOST_CORRIDORS:
        raise InputError(
            f"there are {len(corridors)} corridors; expected at most {MOST_CORRIDORS}: leave out "
            "those that others are inside of."
        )
    for k, one in enumerate(corridors):
        if not 0 <= one.begin <= one.end <= problem.duration + ROUNDING * problem.time_step:
            raise InputError(
                f"corridors[{k}] is from {one.begin:g} to {one.end:g} s; expected times from 0 to "
                f"{problem.duration:g} s, the transfer's duration, the second not before the first."
            )
        if not all(0 <= craft < n for craft in one.craft) or len({*one.craft}) < len(one.craft):
            raise InputError(
                f"corridors[{k}] names craft {brief(one.craft)}; expected numbers from 0 to "
                f"{n - 1}, each once."
            )


@dataclass(frozen=True, eq=False)
class Faces(Rows):
    """Half-spaces that craft stay inside of for some time."""

    craft: Indices  # row of the craft
    corridor: Indices  # index of the corridor in its scenario
    normal: Vectors  # a, of length 1
    offset: Values  # b, m
    begin: Values  # s since the first node
    end: Values  # s

    @classmethod
    def of(cls, corridors: Sequence[Corridor], n: int, first: int = 0) -> "Faces":
        """The faces of the corridors of a scenario with n craft, from row ``first`` on."""
        none, nowhere = np.zeros(0, dtype=int), np.zeros(0)
        parts = [cls(none, none, np.zeros((0, 3)), nowhere, nowhere, nowhere)]
        for k, one in enumerate(corridors):
            normal, offset = one.inside.faces
            for craft in one.craft or range(n):
                same = partial(np.full, len(offset))
                begin, end = same(float(one.begin)), same(float(one.end))
                parts.append(cls(same(first + craft), same(k), normal, offset, begin, end))
        return cls.concatenated(parts)


@dataclass(frozen=True, eq=False)
class Margins(Rows):
    """Least distances of craft from corridors' faces within intervals, positive inside."""

    face: Indices  # index of the face
    interval: Indices  # index of the interval
    offset: Values  # time since the interval's start, s
    margin: Values  # b - a · p at that time, m
    bound: Values  # proven lower bound on it in the interval, m
    state_map: Float[Array, "k 3 6"]  # from the state at the interval's start to the position then
    control_map: Float[Array, "k 3 3"]  # from the control in the interval to it


def margins(
    states: States,
    controls: Controls,
    problem: Problem,
    faces: Faces,
    moved: CraftMask | None = None,
) -> Margins:
    """Least margin of craft inside each face, in each interval in which the face counts."""
    h = problem.time_step
    begin, end, wanted = _stretches(faces, h * np.arange(problem.intervals), h)
    if moved is not None:
        wanted &= moved[faces.craft, None]
    face, k = np.nonzero(wanted)
    begin, length = begin[face, k], (end - begin)[face, k]
    craft, normal, offset = faces.craft[face], faces.normal[face], faces.offset[face]
    start, push = states[craft, k], controls[craft, k]
    fourth = problem.dynamics.linear_motion(k).fourth_derivative_bound(start, push, k)
    parts = np.maximum(1, np.ceil((length**4 / 384 * fourth * 4 / TOLERANCE) ** 0.25)).astype(int)
    row = np.repeat(np.arange(len(face)), parts)
    part = np.arange(len(row)) - np.repeat(np.cumsum(parts) - parts, parts)
    step = length[row] / parts[row]
    from_ = begin[row] + part * step
    ends = []
    for time in (from_, from_ + step):
        A, B = problem.dynamics.step(time, k[row])
        state = np.matvec(A, start[row]) + np.matvec(B, push[row])
        ends.append((np.vecdot(normal[row], state[:, :3]), np.vecdot(normal[row], state[:, 3:])))
    most, share = _largest(ends, step)
    low = offset[row] - most - step**4 / 384 * fourth[row]
    least, at = least_of_each(low, row)
    time = np.zeros(len(face))
    time[least] = from_[at] + share[at] * step[at]
    bound = np.full(len(face), np.inf)
    bound[least] = low[at]
    free, pushed = (maps[:, :3] for maps in problem.dynamics.step(time, k))
    there = np.matvec(free, start) + np.matvec(pushed, push)
    margin = np.maximum(offset - np.vecdot(normal, there), bound)
    return Margins(face, k, time, margin, bound, free, pushed)


def least_margin(
    states: Float[Array, "trials n pieces q 6"], faces: Faces, start: float, duration: float
) -> Nearest:
    """Least margin of craft inside corridors at any time of an arc, given as in ``nearest``.

    For each trial, negative outside; ``first`` is the craft and ``second`` the corridor's index.
    """
    trials, pieces = len(states), states.shape[2]
    length = duration / pieces
    starts = start + length * np.arange(pieces)
    begin, end, wanted = _stretches(faces, starts, length)
    face, piece = np.nonzero(wanted)
    if len(face) == 0:
        return no_pairs(trials)
    begin, step = begin[face, piece], (end - begin)[face, piece] / CUBICS
    times = begin[:, None] + step[:, None] * np.arange(CUBICS + 1)
    motion = states[:, faces.craft[face], piece].reshape(trials, len(face), -1, 2, 3)
    along = np.einsum("tkqdc,kc->tkqd", motion, faces.normal[face])
    ends = np.einsum("kcq,tkqd->tkcd", basis(2 * times / length - 1) @ COEFFICIENTS, along)
    cubics = np.broadcast_to(step[:, None], ends[:, :, 1:, 0].shape)
    both = [(one[..., 0].ravel(), one[..., 1].ravel()) for one in (ends[:, :, :-1], ends[:, :, 1:])]
    most, share = (one.reshape(trials, -1) for one in _largest(both, cubics.ravel()))
    margin = np.repeat(faces.offset[face], CUBICS) - most
    fourth = derivative_bound(along[..., 1:], 3, length / 2)[..., 0]
    bound = margin - np.repeat(step**4 / 384 * fourth, CUBICS, axis=1)
    best = margin.argmin(axis=1)
    k, cubic = np.divmod(best, CUBICS)
    time = starts[piece[k]] + begin[k] + step[k] * (cubic + share[np.arange(trials), best])
    which = faces.craft[face[k]], faces.corridor[face[k]]
    return Nearest(margin.min(axis=1), bound.min(axis=1), *which, time)


def _stretches(
    faces: Faces, starts: Values, h: float
) -> tuple[Float[Array, "F K"], Float[Array, "F K"], Bool[Array, "F K"]]:
    """Begins and ends of the time in which faces count in intervals, s, and whether they do."""
    since, until = faces.begin[:, None] - starts, faces.end[:, None] - starts
    begin, end = np.clip(since, 0.0, h), np.clip(until, 0.0, h)
    # A face that counts at a single time counts in each interval that contains it.
    inside = (-ROUNDING * h <= since) & (since <= h + ROUNDING * h)
    return begin, end, (end > begin) | ((faces.begin == faces.end)[:, None] & inside)


def _largest(ends: Sequence[tuple[Values, Values]], h: Values) -> tuple[Values, Values]:
    """Largest value of each cubic, from values and slopes at both ends, h s apart, and where."""
    (c0, v0), (c3, v3) = ends
    c1, c2 = c0 + h / 3 * v0, c3 - h / 3 * v3
    d0, d1, d2 = c1 - c0, c2 - c1, c3 - c2
    # d0 (1 - t)² + 2 d1 t (1 - t) + d2 t² = 0
    a, b = d0 - 2 * d1 + d2, d1 - d0
    q = -(b + np.where(b < 0, -1.0, 1.0) * np.sqrt(np.maximum(b * b - a * d0, 0.0)))
    with np.errstate(over="ignore"):  # where the cubic is a line, whose root is far outside
        roots = [
            np.divide(one, other, out=np.zeros_like(q), where=np.abs(other) > 0)
            for one, other in ((q, a), (d0, q))
        ]
    t = np.clip(np.stack([np.zeros_like(q), np.ones_like(q), *roots]), 0.0, 1.0)
    rest = 1 - t
    value = rest**3 * c0 + 3 * t * rest**2 * c1 + 3 * t**2 * rest * c2 + t**3 * c3
    best = value.argmax(axis=0), np.arange(len(q))
    return value[best], t[best]
