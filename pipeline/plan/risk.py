"""What risk of a collision is allowed, and what a certificate says of it."""

from dataclasses import dataclass

import numpy as np

from pipeline.errors import InputError
from pipeline.orbit.covariance import Uncertainty
from pipeline.orbit.problem import Problem

LEAST = 1e-9
"""Least risk that can be asked for; no error is Gaussian so far out."""


@dataclass(frozen=True)
class RiskLimit:
    """The risk that a plan may have when it is flown in open loop, and the errors that are meant.

    Attributes:
        asked: most probability that any pair ever comes within the collision radius.
        navigation_sigma: standard deviation of each component of an initial position, m.
        thrust_sigma: of a burn's size, as a share of it, and of its direction, in rad.
        velocity_sigma: of each component of an initial velocity, m/s; by default the mean motion
            times ``navigation_sigma``, the velocity error that goes with such an error of position
            along an orbit.
    """

    asked: float
    navigation_sigma: float = 0.0
    thrust_sigma: float = 0.0
    velocity_sigma: float | None = None

    def __post_init__(self) -> None:
        """Refuse what is no risk or no standard deviation."""
        if not LEAST <= self.asked < 1:
            raise InputError(
                f"risk is {self.asked:g}; expected a probability of at least {LEAST:g} and less "
                "than 1, such as 0.001."
            )
        for name in ("navigation_sigma", "thrust_sigma", "velocity_sigma"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value >= 0):
                raise InputError(f"{name} is {value:g}; expected a number of 0 or more.")

    def uncertainty(self, problem: Problem) -> Uncertainty:
        """The errors of a problem's craft."""
        velocity = self.velocity_sigma
        if velocity is None:
            velocity = problem.mean_motion * self.navigation_sigma
        return Uncertainty(self.navigation_sigma, velocity, self.thrust_sigma, self.thrust_sigma)


@dataclass(frozen=True)
class Risk:
    """What is claimed of the risk of flying a plan in open loop, in the linear model.

    Attributes:
        bound: the probability that any pair comes within the collision radius, at any time from
            the first node to the last, is at most this.
        asked: what it was to be at most.
        uncertainty: standard deviations of the Gaussian errors that are meant.
        sigmas: standard deviations of each pair's separation that the plan was asked to keep
            beyond the collision radius; 0 where the plan was safe enough without.
        fuel_without: fuel of the planner's plan that keeps the collision radius alone, m/s²; None
            where it found none, or plans without a view to the risk.
    """

    bound: float
    asked: float
    uncertainty: Uncertainty
    sigmas: float
    fuel_without: float | None

    @property
    def kept(self) -> bool:
        """Whether the risk is at most what was asked for."""
        return self.bound <= self.asked
