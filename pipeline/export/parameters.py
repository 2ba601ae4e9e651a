"""Orbit parameter messages (OPM 3.0, CCSDS 502.0-B-3) in keyword = value notation, one a craft."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.export.burns import Burns, Masses, burns_of
from pipeline.export.inertial import reference_frames, reference_of
from pipeline.export.messages import described, header, stamp, write_messages
from pipeline.plan import Plan

POINTS = 16  # of Gauss and Legendre in an interval, enough for a revolution


def write_parameters(plan: Plan, folder: Path, name: str, masses: Masses | None) -> list[Path]:
    """Write an OPM for each craft into a folder: its state at the first node, mass and burns.

    A manoeuvre is the velocity that a burn adds, in EME2000. Files of craft that an earlier plan
    had there, and this one has not, are removed. Objects are named by ``name``.

    Raises:
        InputError: without a reference orbit, masses or a specific impulse, or for states that are
            not what the controls lead to.
    """
    epoch = reference_of(plan.scenario).epoch
    if masses is None or masses.specific_impulse is None:
        raise InputError(
            "the masses of the craft are not known, and a manoeuvre in an OPM says what mass it "
            "takes; expected mass (kg) and specific_impulse (s), as in --mass 12 "
            "--specific-impulse 220."
        )
    held, burns, scenario = masses, burns_of(plan, masses), plan.scenario
    origin, frame = reference_frames(scenario, np.zeros(scenario.n))
    states = origin + frame.to_inertial(scenario.initial)
    added = _velocities(plan, burns)

    def message(craft: int) -> Iterator[str]:
        yield from header("CCSDS_OPM_VERS = 3.0", plan, craft)
        yield from described(plan, craft, name)
        yield f"EPOCH = {stamp(epoch)}"
        keys = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
        for key, value in zip(keys, (states[craft] / 1e3).tolist(), strict=True):
            yield f"{key} = {value:.15g}"
        yield f"MASS = {held.mass[craft]:.15g}"
        for row in np.flatnonzero(burns.craft == craft).tolist():
            thrust = " ".join(f"{u:.12e}" for u in burns.acceleration[row].tolist())
            start = float(burns.interval[row]) * scenario.problem.time_step
            yield "COMMENT Constant along the axes of the reference orbit, which turn, m/s**2,"
            yield f"COMMENT radial, along-track and cross-track: {thrust}"
            yield f"MAN_EPOCH_IGNITION = {stamp(epoch, start)}"
            yield f"MAN_DURATION = {scenario.problem.time_step:.15g}"
            yield f"MAN_DELTA_MASS = {-burns.propellant[row]:.15g}"
            yield "MAN_REF_FRAME = EME2000"
            for k, value in enumerate((added[row] / 1e3).tolist(), 1):
                yield f"MAN_DV_{k} = {value:.15g}"

    return write_messages(folder, ".opm", scenario.n, message)


def _velocities(plan: Plan, burns: Burns) -> Float[Array, "burns 3"]:
    """What burns add to inertial velocities, m/s: the integral of what turns with the frame."""
    problem = plan.scenario.problem
    points, weights = np.polynomial.legendre.leggauss(POINTS)
    share = np.arange(problem.intervals)[:, None] + (1 + points) / 2
    turned = reference_frames(plan.scenario, problem.time_step * share)[1].axes
    mean = np.tensordot(turned, weights / 2, axes=(1, 0))
    added: Float[Array, "burns 3"] = problem.time_step * np.matvec(
        mean[burns.interval], burns.acceleration
    )
    return added
