"""How much more separation than r_col is asked for when craft are planned anew."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.flight.errors import Errors
from pipeline.orbit.approaches import TOLERANCE, pairs
from pipeline.orbit.bezier import norm
from pipeline.orbit.problem import Problem
from pipeline.plan import SOLVED
from pipeline.planners.planner import Planner
from pipeline.scenario import Scenario

SIGMAS = 3.0
"""Standard deviations of a relative position that the default margin covers."""

MARGIN_SHARES = (1.0, 0.75, 0.5, 0.25, 0.1)
"""Shares of a margin that are tried in turn at the first node, until there is a safe plan."""

Controls = Float[Array, "n intervals 3"]


def default_margin(errors: Errors, controls: Controls, problem: Problem) -> float:
    """Three standard deviations of a relative position one interval ahead, m.

    What two craft's navigation errors grow to, and what the errors of a burn do meanwhile, along
    the worst direction, for the largest burn of a plan. Fixed errors are counted with it.

    Args:
        errors: of each craft.
        controls: of the plan, m/s².
        problem: whose dynamics and time step.
    """
    h, burn = problem.time_step, float(norm(controls).max())
    A, B = problem.dynamics.step(h)
    position = errors.position**2 + errors.position_bias**2
    velocity = errors.velocity**2 + errors.velocity_bias**2
    share, fixed = (
        max(errors.magnitude, errors.direction),
        max(errors.magnitude_fixed, errors.direction_fixed),
    )
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


def apart_at(states: Float[Array, "K n 6"]) -> Float[Array, "K"]:
    """Least distance of any pair, m; infinite without a pair."""
    i, j = pairs(states.shape[1])
    return norm(states[:, i, :3] - states[:, j, :3]).min(axis=1, initial=np.inf)
