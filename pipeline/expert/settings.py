"""How the expert works; what its plans must satisfy is in ``pipeline.plan.requirements``."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from pipeline.arrays import Array, Float, fields_as_python
from pipeline.errors import check_choice, check_range, check_whole
from pipeline.orbit.approaches import PROVABLE

REFERENCE = 15.0  # separation, m, from which on margins are so many metres; below it they shrink
LARGEST = 1_000_000  # of any number in settings
LEAST_MARGIN = 3 * PROVABLE  # of what a later search for close approaches may find nearer, m

Stop = Literal["converged", "first-safe"]
Solver = Literal["simplex", "clarabel"]


@dataclass(frozen=True)
class Settings:
    """Settings of the expert.

    Attributes:
        stop: go on until the plan no longer improves, or stop at the first safe one.
        gap_tolerance: a cluster whose optimality gap is at most this is done.
        improvement: a cluster that gains no more than this share of its fuel is done.
        starts: searches, each begun by passing on other sides, of which the best is kept.
        margin: separation asked for beyond the collision radius, m, so that small shifts stay
            safe; the smaller, the less fuel and the more rounds. In proportion less for
            separations below 15 m.
        look_ahead: pairs that pass within this of the collision radius are cut before they
            violate it, m; the larger, the fewer rounds of larger programs. In proportion less for
            a collision radius below 15 m.
        cut_spread: how long before and after each closest approach of a seed it is cut as well,
            as a share of the interval; the plan that follows is closest at other times.
        max_rounds: rounds of programs that a search may take.
        passive_safety_starts: further searches, each begun by passing on other sides, of a
            scenario for which passive safety is asked and no plan that has it was found.
        solver: the subproblem by the simplex method of HiGHS or by the interior points of Clarabel.
    """

    stop: Stop = "converged"
    gap_tolerance: float = 1e-3
    improvement: float = 1e-3
    starts: int = 1
    margin: float = 0.05
    look_ahead: float = 0.5
    cut_spread: float = 0.0
    max_rounds: int = 60
    passive_safety_starts: int = 16
    solver: Solver = "simplex"

    def __post_init__(self) -> None:
        fields_as_python(self)
        check_choice("stop", self.stop, get_args(Stop))
        check_choice("solver", self.solver, get_args(Solver))
        for name in ("gap_tolerance", "improvement", "margin", "look_ahead", "cut_spread"):
            check_range(name, getattr(self, name), 0.0, LARGEST)
        for name, least in (("starts", 1), ("max_rounds", 0), ("passive_safety_starts", 0)):
            check_whole(name, getattr(self, name), least, LARGEST)

    def margin_at(self, separation: Float[Array, "*pairs"]) -> Float[Array, "*pairs"]:
        """Margin beyond each pair's required separation, m, for that separation, m."""
        share = np.maximum(self.margin * separation / REFERENCE, LEAST_MARGIN)
        return np.asarray(np.minimum(self.margin, share))

    def cut_distance(self, radius: float) -> float:
        """Largest separation of pairs that get cuts, m, for a collision radius, m."""
        return radius + self.look_ahead * min(1.0, radius / REFERENCE)


Effort = Literal["first", "default", "best"]  # names of EFFORTS

# For the least fuel, at some twenty times the time
BEST = Settings(gap_tolerance=1e-4, improvement=2e-4, starts=8, margin=0.005)
FIRST_SAFE = Settings(stop="first-safe", margin=0.2, look_ahead=4.0)  # least time, a bit more fuel
# By name: the first safe plan, one that no longer improves, the best of several searches
EFFORTS = {"first": FIRST_SAFE, "default": Settings(), "best": BEST}
