"""A plan, and what can become of a scenario."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.plan.assignment import Assignment
from pipeline.plan.certificate import Certificate
from pipeline.plan.requirements import Requirements, Separation
from pipeline.scenario import Scenario

SOLVED = "solved"
"""Dynamics, both ends in all six components, thrust limit and separation all hold."""

UNSAFE = "unsafe"
"""Flies to the goal, but does not satisfy all that is required; the message says what."""

INFEASIBLE = "infeasible"
"""Proven: some craft cannot reach its goal, a pair is too close at an end, the only controls there
are bring craft together, or a craft is in the way of another after a loss of thrust, whatever is
planned; the message says which."""

UNSOLVED = "unsolved"
"""The planner has no safe plan and no proof that there is none; the message says why."""


@dataclass(frozen=True, eq=False)
class Plan:
    """What each craft of a scenario is to do.

    Attributes:
        planner: name of the planner.
        status: SOLVED, UNSAFE, INFEASIBLE or UNSOLVED.
        states: node states (n, T, 6), m and m/s.
        controls: accelerations held over each interval (n, T-1, 3), m/s².
        certificate: cost, bound and separation.
        convex_solves: joint convex programs that it took.
        timing: seconds by stage; "plan" is from scenario to controls.
        message: why, where the status is not SOLVED.
        assignment: who takes which of the given goals, where that was chosen: the plan is for the
            scenario's goals in that order.
        separation: when craft were to be kept apart: at all times, or at the nodes only.
    """

    planner: str
    status: str
    states: Float[Array, "n T 6"]
    controls: Float[Array, "n intervals 3"]
    certificate: Certificate
    convex_solves: int = 0
    timing: Mapping[str, float] = field(default_factory=dict)
    message: str = ""
    assignment: Assignment | None = None
    separation: Separation = "continuous"

    @property
    def requirements(self) -> Requirements:
        """What was asked of its flight without errors; of a risk its certificate says what.

        Raises:
            InputError: for passive safety that is none, or together with separation at nodes only.
        """
        adrift = self.certificate.passive_safety
        return Requirements(self.separation, None if adrift is None else adrift.orbits)

    def flown(self, scenario: Scenario) -> Scenario:
        """The scenario that it is for: the one given, its goals in the order of the assignment."""
        return scenario if self.assignment is None else scenario.taking(self.assignment.slots)
