"""Where and when the reference orbit of a plan is: states, LVLH frames (EME2000), epochs (UTC)."""

import json
from datetime import datetime, timedelta

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.errors import InputError
from pipeline.orbit.inertial import Elements, Frame, lvlh_frame
from pipeline.orbit.reference import Reference, radius_at
from pipeline.scenario import Scenario

ANGLES = {"inclination_deg": 97.4, "raan_deg": 40, "argument_of_latitude_deg": 0}
EXAMPLE = {"epoch": "2026-03-01T12:00:00Z", **ANGLES}


def reference_of(scenario: Scenario, instead: str = "") -> Reference:
    """When and where the reference orbit is; InputError where the scenario does not say.

    The error names what would do ``instead``.
    """
    if scenario.reference is None:
        orbit = scenario.problem.orbit
        known = {} if orbit is None else {name: getattr(orbit, name) for name in ANGLES}
        wanted, yours = json.dumps(EXAMPLE | known), "values" if orbit is None else "epoch"
        raise InputError(
            f'the plan has no reference orbit; expected in its scenario "reference": {wanted} with '
            f"your {yours}{instead}: add it."
        )
    return scenario.reference


def reference_frames(
    scenario: Scenario, time: Float[Array, "*batch"]
) -> tuple[Float[Array, "*batch 6"], Frame]:
    """Inertial states of the reference orbit (m, m/s) and LVLH frames, at times since its start, s.

    Those of the scenario's own orbit, or of the circular two-body orbit of its ``reference``;
    InputError where it has neither.
    """
    if scenario.problem.orbit is not None:
        return scenario.problem.orbit.frames(time)
    rate = scenario.problem.mean_motion
    where = reference_of(scenario, ', or an "orbit"')
    i, raan, latitude = np.deg2rad(
        [where.inclination_deg, where.raan_deg, where.argument_of_latitude_deg]
    ).tolist()
    origin = Elements(radius_at(rate), i, raan).states(latitude + rate * time)
    return origin, lvlh_frame(origin, np.zeros((*time.shape, 3)))  # two-body: the plane stays


def stamp(time: datetime, seconds: float = 0.0) -> str:
    """A time, so many seconds later, as text in whole microseconds."""
    later = time + timedelta(microseconds=round(1e6 * seconds))
    return later.strftime("%Y-%m-%dT%H:%M:%S.%f")
