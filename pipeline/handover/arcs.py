"""A plan's thrust arcs, sampled densely enough to interpolate."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.orbit.inertial import Elements, lvlh_frame
from pipeline.orbit.reference import Reference, radius_at
from pipeline.orbit.transfer import dynamics_defect
from pipeline.plan import Plan
from pipeline.plan.planned import POSITION_TOLERANCE
from pipeline.scenario import Scenario

FEWEST = 8
"""States of an arc, so that readers that take eight for degree 7 find them."""

SPACING = 0.05
"""Largest angle between states as the reference orbit turns, rad: polynomials of degree 7 through
states this near miss a circle by less than 1e-6 of a metre at any altitude up to geostationary."""


@dataclass(frozen=True, eq=False)
class Arcs:
    """Inertial states of every craft over intervals of constant thrust.

    Attributes:
        microseconds: since the epoch, (intervals, q); an arc ends when the next begins.
        states: in EME2000 at those times, (n, intervals, q, 6), m and m/s.
    """

    microseconds: Int[Array, "intervals q"]
    states: Float[Array, "n intervals q 6"]


def check_states(plan: Plan, scenario: Scenario) -> None:
    """Refuse a plan whose states do not begin at the scenario's or are not where it leads.

    Raises:
        InputError: saying how far they are off.
    """
    defect = dynamics_defect(plan.states, plan.controls, scenario.problem)[..., :3]
    start = (plan.states[:, 0] - scenario.initial)[:, :3]
    off = max(float(np.abs(defect).max()), float(np.abs(start).max()))
    if not off <= POSITION_TOLERANCE:
        raise InputError(
            f"the plan's states are up to {off:.3g} m off those that its controls lead to; "
            "expected a plan as it was made: plan again."
        )


def thrust_arcs(plan: Plan, scenario: Scenario) -> Arcs:
    """The arcs of a plan, by the motion that it has under constant thrust.

    Times are whole microseconds, and states are those at these very times.

    Raises:
        InputError: where the scenario has no reference orbit, the plan's states are not what its
            controls lead to, or nodes are too near each other for microseconds.
    """
    problem, reference = scenario.problem, scenario.reference
    if reference is None:
        raise InputError(
            "the plan has no reference orbit; expected in its scenario "
            '"reference": {"epoch": "2026-03-01T12:00:00Z", "inclination_deg": 97.4, '
            '"raan_deg": 40, "argument_of_latitude_deg": 0} with your values: add it.'
        )
    check_states(plan, scenario)
    steps = max(FEWEST - 1, int(np.ceil(problem.mean_motion * problem.time_step / SPACING)))
    start = problem.time_step * np.arange(problem.intervals)[:, None]
    microseconds = np.rint(1e6 * (start + problem.time_step * np.arange(steps + 1) / steps))
    if np.diff(microseconds).min() < 1:
        raise InputError(
            f"time_step is {problem.time_step:g} s; expected at least {FEWEST} microseconds, which "
            "is what epochs in a file tell apart."
        )
    time = microseconds * 1e-6
    A, B = problem.dynamics.step(time - start)
    relative = np.matvec(A, plan.states[:, :-1, None]) + np.matvec(B, plan.controls[:, :, None])
    origin = _circle(time, reference, problem.mean_motion)
    frame = lvlh_frame(origin, np.zeros((*time.shape, 3)))  # two-body: the plane stays
    return Arcs(microseconds.astype(int), origin + frame.to_inertial(relative))


def _circle(
    time: Float[Array, "intervals q"], reference: Reference, mean_motion: float
) -> Float[Array, "intervals q 6"]:
    """States of the reference orbit in EME2000, so long after its epoch, s."""
    i, raan, start = np.deg2rad(
        [reference.inclination_deg, reference.raan_deg, reference.argument_of_latitude_deg]
    ).tolist()
    return Elements(radius_at(mean_motion), i, raan).states(start + mean_motion * time)
