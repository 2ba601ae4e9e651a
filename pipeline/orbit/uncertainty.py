"""What is not known of a swarm, and not done as it was asked."""

from dataclasses import dataclass, fields

import numpy as np

from pipeline.errors import InputError


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations of Gaussian errors, independent between craft, components and times.

    A burn is one interval's control. Its errors are Gates's proportional ones (Gates 1963, "A
    simplified model of midcourse maneuver execution errors", JPL TR 32-504): along the burn in its
    size, across it in its direction.

    Attributes:
        position: of each component of a position as it is known, m.
        velocity: of each component of a velocity as it is known, m/s.
        magnitude: of a burn's size, as a share of it.
        direction: of a burn's direction, about each axis across it, rad.
    """

    position: float = 0.0
    velocity: float = 0.0
    magnitude: float = 0.0
    direction: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no standard deviation."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"{field.name} is {value}; expected a number of 0 or more.")
