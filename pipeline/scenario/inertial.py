"""Scenarios from inertial states: the reference orbit, and states relative to it."""

from dataclasses import replace
from datetime import datetime

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.orbit.arrays import Formation
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import Reference
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.scenario.document import document_of, scenario_from
from pipeline.scenario.orbit_document import ANGLES
from pipeline.scenario.scenario import Scenario
from pipeline.scenario.state_files import Inertial, check_frames
from pipeline.scenario.validation import drifts

EXACT = 1e-6  # m, and in m/s a thousandth of it: most that states turned back may be off


def scenario_from_inertial(
    initial: Inertial,
    goal: Inertial,
    problem: Problem,
    *,
    chief: Inertial | None = None,
    epoch: datetime | None = None,
    j2: bool = True,
    ballistic: float | None = None,
    spread: float = 0.0,
) -> Scenario:
    """The scenario of inertial states at the first node and at the last.

    The reference orbit has the osculating elements of the chief at the first node, or those of the
    mean of the craft's states there, and is flown to the last node under the forces.

    Args:
        initial: states, of ephemerides at the epoch of the first node.
        goal: of the same craft in the same order; of ephemerides at the time of the last node.
        problem: time grid and limits; its orbit is replaced.
        chief: the one craft that the reference orbit is that of, or None.
        epoch: of the first node, UTC; by default the first at which all ephemerides of initial
            states and chief have a state, where there are some.
        j2: whether the Earth is oblate.
        ballistic: mean C_D A/m of the swarm, m²/kg, or None for no drag.
        spread: by what share of it the first craft has less, and the last more.

    Raises:
        InputError: where states are missing, in several frames, or not near the reference orbit.
    """
    given = [one for one in (initial, chief, goal) if one is not None]
    check_frames(given)
    starts = [one.start for one in (initial, chief) if one is not None and one.start is not None]
    epoch = epoch or max(starts, default=None)
    first, last = initial.states(epoch, 0.0), goal.states(epoch, problem.duration)
    middle = first.mean(axis=0) if chief is None else _only(chief.states(epoch, 0.0), chief.name)
    orbit = ReferenceOrbit.through(middle, j2=j2, ballistic=ballistic, spread=spread)
    problem = problem.about(orbit)
    start, end = _relative(first, orbit, 0.0), _relative(last, orbit, problem.duration)
    angles = (getattr(orbit, name) for name in ANGLES)
    reference = None if epoch is None else Reference(epoch, *angles)
    scenario = Scenario(problem, start, end, reference=reference)
    scenario = replace(scenario, ends="any" if drifts(scenario) else "passive")
    _check_inverse(scenario, first, last)
    return scenario


def _only(states: Formation, name: str) -> Float[Array, "6"]:
    """The state of the chief, the only craft of its file."""
    if len(states) != 1:
        raise InputError(f"{name} has {len(states)} craft; expected one, the chief.")
    return np.asarray(states[0])


def _relative(states: Formation, orbit: ReferenceOrbit, time: float) -> Formation:
    """LVLH states at a time since the first node, s."""
    origin, frame = orbit.frames(np.array(time))
    return frame.from_inertial(states - origin)


def _check_inverse(scenario: Scenario, first: Formation, last: Formation) -> None:
    """Refuse a scenario whose file, once it is read, does not give the inertial states back."""
    kept = scenario_from(document_of(scenario), scenario.name)
    orbit = kept.problem.orbit
    assert orbit is not None
    for name, states, given, time in (
        ("initial", kept.initial, first, 0.0),
        ("goal", kept.goal, last, kept.problem.duration),
    ):
        origin, frame = orbit.frames(np.array(time))
        off = np.abs(origin + frame.to_inertial(states) - given).max(axis=0)
        if not (off < np.repeat([EXACT, EXACT / 1e3], 3)).all():
            raise InputError(
                f"{name} states relative to the reference orbit give the inertial ones back only "
                f"to {off[:3].max():.2g} m and {off[3:].max():.2g} m/s; expected {EXACT:g} m: take "
                "a chief nearer to the craft."
            )
