"""What a plan must satisfy."""

from dataclasses import dataclass, replace
from typing import Literal, get_args

from pipeline.errors import InputError
from pipeline.orbit.passive_safety import check_orbits
from pipeline.plan.risk import RiskLimit

Separation = Literal["continuous", "nodes"]
"""When craft are kept apart: at all times, or at the nodes only, the paper's criterion (Eq. 5)."""


@dataclass(frozen=True)
class Requirements:
    """What a plan must satisfy besides dynamics, both ends and the limits of its problem.

    The problem states the collision radius and the thrust limit, which bind every plan; here is
    what may be asked of a plan for it. A planner takes it whole, and what a plan does not satisfy
    its certificate shows and its status says.

    Attributes:
        separation: keep craft apart at all times or at the nodes only.
        passive_safety: also for so many orbits after any one of them has lost its thrust at a
            node, or None.
        risk: also with at least some probability when craft err in open loop, or None.
    """

    separation: Separation = "continuous"
    passive_safety: float | None = None
    risk: RiskLimit | None = None

    def __post_init__(self) -> None:
        """Refuse what has no meaning, alone or together."""
        if self.separation not in get_args(Separation):
            raise InputError(
                f"separation is {self.separation!r}; expected continuous or nodes, to keep craft "
                "apart at all times or at the nodes only."
            )
        if self.passive_safety is not None:
            check_orbits(self.passive_safety)
        besides = {"passive safety": self.passive_safety, "a risk": self.risk}
        for what, asked in besides.items():
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
        """What is asked of the flight without errors."""
        return replace(self, risk=None)


AT_ALL_TIMES = Requirements()
"""Craft apart at all times, and nothing besides."""
