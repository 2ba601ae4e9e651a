"""Ways to fly a plan: open loop, replanned at every node, and replanned with a margin.

The margin is separation asked for beyond r_col, so that errors use it up before craft are at risk.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from pipeline.flight.closed_loop import ClosedLoop, apart_at
from pipeline.flight.errors import Draws, Errors
from pipeline.flight.trials import TrialResults, fly_trials, open_loop
from pipeline.flight.world import World
from pipeline.orbit.approaches import TOLERANCE
from pipeline.orbit.arrays import Controls
from pipeline.orbit.bezier import norm
from pipeline.orbit.problem import Problem
from pipeline.plan import SOLVED
from pipeline.planners.planner import Planner
from pipeline.scenario import Scenario

OPEN, REPLANNED, MARGIN = "open loop", "replanned", "with margin"  # names of the loops
SIGMAS = 3.0  # standard deviations of a relative position that the default margin covers

MARGIN_SHARES = (1.0, 0.75, 0.5, 0.25, 0.1)
"""Shares of a margin that are tried in turn at the first node, until there is a safe plan."""


@dataclass(frozen=True, eq=False)
class Loop:
    """A way to fly a plan's controls, m/s²: in open loop, or with a planner that replans.

    A margin, m, is asked for beyond the collision radius when replanning.
    """

    name: str
    controls: Controls
    planner: Planner | None = None
    margin: float = 0.0

    def fly(
        self, scenario: Scenario, world: World, drawn: Draws, errors: Errors
    ) -> tuple[TrialResults, ClosedLoop | None]:
        """Fly trials as in ``fly_trials``; with them the replanning, where there is any."""
        if self.planner is None:
            return fly_trials(scenario, world, open_loop(self.controls), drawn, errors), None
        closed = ClosedLoop(scenario, self.controls, self.planner, len(drawn.bias), self.margin)
        return fly_trials(scenario, world, closed, drawn, errors), closed


def flight_loops(
    scenario: Scenario,
    controls: Controls,
    errors: Errors,
    planner: Planner | None = None,
    margin: float | None = None,
) -> Iterator[Loop]:
    """The open loop of a plan's controls, m/s², and with a planner two closed loops.

    The last one asks for a margin, m, as far as there is room; by default the one for ``errors``.
    """
    yield Loop(OPEN, controls)
    if planner is None:
        return
    yield Loop(REPLANNED, controls, planner)
    wanted = default_margin(errors, controls, scenario.problem) if margin is None else margin
    wider, allowed = with_margin(scenario, controls, planner, wanted)
    yield Loop(MARGIN, wider, planner, allowed)


def default_margin(errors: Errors, controls: Controls, problem: Problem) -> float:
    """Three standard deviations of a relative position one interval ahead, m.

    To these, two craft's navigation errors grow, and the errors of the largest burn of the controls
    (m/s²) lead meanwhile, along the worst direction. Fixed errors of burns count with it.
    """
    h, burn = problem.time_step, float(norm(controls).max())
    A, B = problem.dynamics.step(h)
    position = errors.position**2 + errors.position_bias**2
    velocity = errors.velocity**2 + errors.velocity_bias**2
    share = max(errors.magnitude, errors.direction)
    fixed = max(errors.magnitude_fixed, errors.direction_fixed)
    thrust = (share * burn) ** 2 + (fixed / h) ** 2 * (burn > 0)
    late = (errors.timing * burn) ** 2
    covariance = A[:3] @ np.diag(np.repeat([position, velocity], 3)) @ A[:3].T
    covariance += thrust * B[:3] @ B[:3].T + late * A[:3, 3:] @ A[:3, 3:].T
    return SIGMAS * float(np.sqrt(2 * np.linalg.eigvalsh(covariance).max()))


def with_margin(
    scenario: Scenario, controls: Controls, planner: Planner, margin: float
) -> tuple[Controls, float]:
    """Controls with more separation than r_col, m/s², and how much more, m.

    As much of the margin as both formations leave room for, or the largest share of that with
    which the planner finds a safe plan; where there is none, the controls that are given.
    """
    radius = scenario.problem.collision_radius
    room = min(float(apart_at(end[None])[0]) for end in (scenario.initial, scenario.goal)) - radius
    most = min(margin, room - 2 * TOLERANCE)
    for share in MARGIN_SHARES if most > 0 else ():
        wider = replace(scenario.problem, collision_radius=radius + share * most)
        (plan,) = planner.plan([replace(scenario, problem=wider)])
        if plan.status == SOLVED:
            return plan.controls, share * most
    return controls, 0.0
