"""Thrust: the model of thrusters, limits on controls, and times without burns."""

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from pipeline.arrays import Array, Bool, Float, fields_as_python
from pipeline.errors import InputError, check_choice, check_each, check_range, check_vector
from pipeline.orbit.arrays import PerCraft, Rows

COMPONENTS, NORM = "components", "norm"
ALL_WAYS = 1e-3  # least radius of a ball in the hull of thrusters that push in all directions
MOST_DIRECTIONS = 64
LENGTH = 1e-6  # tolerance of the length of a direction, which is 1
ON_GRID = 1e-6  # share of an interval by which a time may be off the node that it means

Windows = tuple[tuple[float, float], ...]  # begin and end, s since the first node
Objective = Literal["total", "fair"]
Direction = tuple[float, float, float]


def check_windows(no_burn: Windows) -> None:
    """Raise InputError for windows that are no pair of times or end before they begin."""
    check_each("no_burn", no_burn, tuple)
    for k, stretch in enumerate(no_burn):
        check_vector(f"no_burn[{k}]", stretch, 2)
        begin, end = stretch
        if not 0 <= begin < end:
            raise InputError(
                f"no_burn has {begin:g} to {end:g} s; expected 0 or more, and then a later time, "
                "in s since the first node."
            )


@dataclass(frozen=True)
class Thrust:
    """Thrusters, and constraints on burns, the same for all craft of a problem.

    Attributes:
        model: components, thrusters along the three axes, whose thrusts add up to ‖u‖₁; norm, one
            thruster that is pointed, ‖u‖₂; or directions, unit vectors in LVLH of the accelerations
            that thrusters give, of which each control is a sum.
        max_acceleration_norm: limit on ‖u‖₂, m/s², or None.
        min_delta_v: minimum impulse bit: least Δv of a burn that is not zero, of a thruster over
            an interval, m/s, or None.
        no_burn: stretches of time from and to, s since the first node, in which no craft burns; an
            interval that overlaps one has no burn.
        objective: what is minimized: total, the fuel of all; or fair, the largest share that a
            craft burns of the Δv that it has left.
    """

    model: Literal["components", "norm"] | tuple[Direction, ...] = "components"
    max_acceleration_norm: float | None = None
    min_delta_v: float | None = None
    no_burn: Windows = ()
    objective: Objective = "total"

    def __post_init__(self) -> None:
        fields_as_python(self)
        if isinstance(self.model, tuple):
            check_directions(self.model)
        elif not isinstance(self.model, str) or self.model not in (COMPONENTS, NORM):
            raise InputError(
                f"thrust is {self.model!r}; expected components, norm or a list of directions."
            )
        for name in ("max_acceleration_norm", "min_delta_v"):
            if (value := getattr(self, name)) is not None:
                check_range(name, value, 1e-12, 1e6)
        check_windows(self.no_burn)
        check_choice("objective", self.objective, get_args(Objective))

    @property
    def total(self) -> str:
        """The formula of a plan's fuel, over craft and intervals, as text."""
        sums = {COMPONENTS: "Σ‖u‖₁", NORM: "Σ‖u‖₂"}
        return sums[self.model] if isinstance(self.model, str) else "sum of all thrusts"

    @property
    def directions(self) -> Float[Array, "K 3"] | None:
        """Unit vectors of thrusters; None for a single one that is pointed."""
        if self.model == COMPONENTS:
            return np.concatenate([np.eye(3), -np.eye(3)])
        return None if self.model == NORM else np.array(self.model)


ALONG_AXES = Thrust()  # without limits of its own


def check_directions(directions: tuple[Direction, ...]) -> None:
    """Raise InputError for thrusters that do not push in all directions or are not unit vectors."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import, and few thrusters need it

    for k, one in enumerate(directions):
        check_vector(f"thrust[{k}]", one)
    given = np.array(directions)
    if not 4 <= len(given) <= MOST_DIRECTIONS:
        raise InputError(
            f"thrust has {len(given)} directions; expected 4 to {MOST_DIRECTIONS}, or components "
            "or norm."
        )
    length = np.array([math.hypot(*one) for one in directions])  # of 1e300, too
    k = int(np.abs(length - 1).argmax())
    if not abs(length[k] - 1) <= LENGTH:
        raise InputError(
            f"thrust[{k}] has length {length[k]:.9g}; expected a direction of length 1."
        )
    least = 0.0
    with suppress(QhullError):  # distances of facets from the origin, positive where it is inside
        least = -float(ConvexHull(given).equations[:, 3].max())
    if least < ALL_WAYS:
        raise InputError(
            "thrust has directions that do not push all ways; expected thrusters whose hull has "
            "the origin inside: add one opposite to the others."
        )


@dataclass(frozen=True, eq=False)
class Limits(Rows):
    """Limits of the thrusters of each of n craft."""

    component: PerCraft  # limit on a control's components, or a thruster's thrust, m/s²
    norm: PerCraft  # largest ‖u‖₂, m/s²
    delta_v: PerCraft  # Δv left, m/s
    burns: Bool[Array, "n intervals 3"]  # components that may be nonzero
    # directions in which a pointed thruster gives at least the minimum impulse bit; 0 for none
    least: Float[Array, "n intervals 3"] | None = None

    @property
    def bounded(self) -> bool:
        """Whether any craft has a limit of thrust or of Δv."""
        return bool(np.isfinite([self.component, self.norm, self.delta_v]).any())


def blocked_intervals(
    windows: Windows, time_step: float, intervals: int
) -> Bool[Array, "intervals"]:
    """Mask of intervals that overlap a window without burns, by more than rounding of its ends."""
    each, found = np.arange(intervals), np.zeros(intervals, dtype=bool)
    for begin, end in windows:
        first = np.floor(begin / time_step + ON_GRID)
        last = max(first, np.ceil(end / time_step - ON_GRID) - 1)
        found |= (first <= each) & (each <= last)
    return found
