"""What a plan must satisfy besides dynamics, both ends and the limits of its problem."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

from pipeline.arrays import fields_as_python
from pipeline.errors import InputError, check_kind, check_range, is_number
from pipeline.orbit.covariance import MAX_ERRORS, Uncertainty
from pipeline.orbit.problem import Problem
from pipeline.scenario import Scenario

# When craft are kept apart: at all times, or at the nodes only, the paper's criterion (Eq. 5)
SeparationKind = Literal["continuous", "nodes"]

MOST_ORBITS = 100.0  # longest drift; the linear model is no longer accurate over so many orbits
LEAST = 1e-9  # least risk that can be asked for; no error is Gaussian so far out
# Sigmas of a risk limit, each with the error of ``Uncertainty`` whose range it has
SIGMAS = {"navigation_sigma": "position", "thrust_sigma": "magnitude", "velocity_sigma": "velocity"}


@dataclass(frozen=True)
class RiskLimit:
    """The largest collision risk of a plan flown with errors, and the errors it refers to.

    Attributes:
        asked: largest probability that any pair ever comes within the collision radius.
        navigation_sigma: standard deviation of each component of an initial position, m.
        thrust_sigma: of a burn's size, as a share of it, and of its direction, in rad.
        velocity_sigma: of each component of an initial velocity, m/s; by default the mean motion
            times ``navigation_sigma``, the velocity error that goes with such an error of position
            along an orbit.
        closed_loop: deviations are estimated at each node with the same errors and corrected
            (``pipeline.orbit.feedback``); otherwise it is flown in open loop.
        errors: all errors, instead of the sigmas; their Gaussian ones count.
    """

    asked: float
    navigation_sigma: float | None = None
    thrust_sigma: float | None = None
    velocity_sigma: float | None = None
    closed_loop: bool = False
    errors: Uncertainty | None = None

    def __post_init__(self) -> None:
        fields_as_python(self)
        if not (is_number(self.asked) and LEAST <= self.asked < 1):
            raise InputError(
                f"risk is {_said(self.asked)}; expected a probability of at least {LEAST:g} and "
                "less than 1, such as 0.001."
            )
        check_kind("errors", self.errors, Uncertainty | None)
        sigmas = [name for name in SIGMAS if getattr(self, name) is not None]
        if self.errors is not None and sigmas:
            raise InputError(
                "errors are given, and a sigma is given besides; expected one of the two."
            )
        for name in sigmas:
            check_range(name, getattr(self, name), 0.0, MAX_ERRORS[SIGMAS[name]])
        if self.uncertainty(Problem()) == Uncertainty():
            raise InputError(
                f"risk is {self.asked:g} and no error is given; expected a navigation, thrust or "
                "velocity sigma above 0 with it, or errors such as those of cold gas."
            )

    def uncertainty(self, problem: Problem) -> Uncertainty:
        """The 1-σ errors of a problem's craft."""
        if self.errors is not None:
            return self.errors.gaussian(problem.time_step)
        position, thrust = self.navigation_sigma or 0.0, self.thrust_sigma or 0.0
        given = self.velocity_sigma
        velocity = problem.mean_motion * position if given is None else given
        return Uncertainty(position, velocity, thrust, thrust)


@dataclass(frozen=True)
class Requirements:
    """What a plan must satisfy besides the collision radius and thrust limits of its problem.

    The certificate shows what a plan does not satisfy, and its status says so.

    Attributes:
        separation: keep craft apart at all times or at the nodes only.
        passive_safety: number of orbits for which craft also stay apart after any one of them has
            lost its thrust at a node, or None.
        risk: also keep the collision risk with errors, in open or closed loop, below a limit, or
            None.
    """

    separation: SeparationKind = "continuous"
    passive_safety: float | None = None
    risk: RiskLimit | None = None

    def __post_init__(self) -> None:
        fields_as_python(self)
        if not isinstance(self.separation, str) or self.separation not in get_args(SeparationKind):
            raise InputError(
                f"separation is {self.separation!r}; expected continuous or nodes, to keep craft "
                "apart at all times or at the nodes only."
            )
        orbits = self.passive_safety
        if orbits is not None and not (is_number(orbits) and 0 < orbits <= MOST_ORBITS):
            raise InputError(
                f"passive safety is asked for over {_said(orbits)} orbits; expected a "
                f"number above 0 and at most {MOST_ORBITS:g}."
            )
        if self.risk is not None and not isinstance(self.risk, RiskLimit):
            raise InputError(
                f"risk is {self.risk!r}; expected a RiskLimit, with the errors that it is of, such "
                "as RiskLimit(0.001, navigation_sigma=0.05)."
            )
        for what, asked in (("passive safety", orbits), ("a risk", self.risk)):
            if asked is not None and self.at_nodes:
                raise InputError(
                    f"{what} is asked for with separation at the nodes only; expected craft that "
                    "are kept apart at all times with it: leave one of the two out."
                )

    @property
    def at_nodes(self) -> bool:
        """Whether separation counts at the nodes only."""
        return self.separation == "nodes"

    @property
    def nominal(self) -> "Requirements":
        """The requirements on the flight without errors."""
        return self if self.risk is None else replace(self, risk=None)


def _said(given: object) -> str:
    return f"{given:g}" if is_number(given) else repr(given)


AT_ALL_TIMES = Requirements()  # craft apart at all times, and nothing besides


def refuse_risk(scenarios: Sequence[Scenario], *, closed_loop: bool = False) -> None:
    """Raise InputError for scenarios that no risk limit is possible for: with sizes or corridors.

    In closed loop also for those with further thrust limits, or waypoints.
    """
    if closed_loop and any(one.limits is not None for one in scenarios):
        raise InputError(
            "a risk is asked for in closed loop, and the scenario says more of thrust than "
            "max_acceleration, or has waypoints, which corrections do not know; expected one of "
            "the two: leave closed_loop out, or these."
        )
    if any(one.unlike for one in scenarios):
        raise InputError(
            "a risk is asked for, and craft have radii of their own or there are obstacles or "
            "corridors; expected one of the two: leave the risk out, or these."
        )
