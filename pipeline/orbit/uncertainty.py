"""What is not known of a swarm, and not done as it was asked."""

from dataclasses import dataclass, fields

from pipeline.errors import check_range

MOST = {
    **dict.fromkeys(("position", "position_bias"), 1e3),
    **dict.fromkeys(("velocity", "velocity_bias", "magnitude_fixed", "direction_fixed"), 10.0),
    **dict.fromkeys(("magnitude", "direction"), 0.3),
    "timing": 1e3,
    "missed": 1.0,
}
"""Largest errors, SI: beyond any with which craft would be flown near each other."""


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
            check_range(field.name, getattr(self, field.name), 0.0, MOST[field.name])
