"""Orbit ephemeris messages (OEM 2.0, CCSDS 502.0-B) in keyword = value notation, one a craft."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.export.inertial import reference_frames, reference_of
from pipeline.export.messages import described, header, stamp, write_messages
from pipeline.orbit.nonlinear import flown_between
from pipeline.plan import Plan
from pipeline.plan.judge import check_states

FEWEST = 8  # states of an arc, so that readers that take eight for degree 7 find them
# Largest angle between states as the reference orbit turns, rad: polynomials of degree 7 through
# states this near miss a circle by less than 1e-6 of a metre at any altitude up to geostationary
SPACING = 0.05
DEGREE = 7  # of the Hermite interpolation that files ask for


def write_ephemerides(plan: Plan, folder: Path, name: str) -> list[Path]:
    """Write an OEM for each craft into a folder, a segment for each interval of constant thrust.

    Thrust jumps at nodes, and no interpolation may reach across a jump. Files of craft that an
    earlier plan had there, and this one has not, are removed. Objects are named by ``name``.
    """
    arcs = thrust_arcs(plan)

    def message(craft: int) -> Iterator[str]:
        yield from header("CCSDS_OEM_VERS = 2.0", plan, craft)
        for arc in range(plan.scenario.problem.intervals):
            yield from _segment(plan, arcs, craft, arc, name)

    return write_messages(folder, ".oem", plan.scenario.n, message)


@dataclass(frozen=True, eq=False)
class Arcs:
    """Inertial states of every craft over intervals of constant thrust."""

    epoch: datetime  # of the first node, UTC
    microseconds: Int[Array, "intervals q"]  # since the epoch; an arc ends when the next begins
    states: Float[Array, "n intervals q 6"]  # in EME2000 at those times, m and m/s


def thrust_arcs(plan: Plan) -> Arcs:
    """The arcs of a plan under constant thrust, sampled densely enough to interpolate.

    Times are whole microseconds, and states are those at these very times. InputError without a
    reference orbit, for states that are not what the controls lead to, or for nodes too near each
    other.
    """
    problem, reference = plan.scenario.problem, reference_of(plan.scenario)
    check_states(plan)
    steps = max(FEWEST - 1, int(np.ceil(problem.mean_motion * problem.time_step / SPACING)))
    start = problem.time_step * np.arange(problem.intervals)[:, None]
    microseconds = np.rint(1e6 * (start + problem.time_step * np.arange(steps + 1) / steps))
    if np.diff(microseconds).min() < 1:
        raise InputError(
            f"time_step is {problem.time_step:g} s; expected at least {FEWEST} microseconds, which "
            "is what epochs in a file tell apart."
        )
    time = microseconds * 1e-6
    origin, frame = reference_frames(plan.scenario, time)
    states = origin + frame.to_inertial(_relative(plan, time - start))
    return Arcs(reference.epoch, microseconds.astype(int), states)


def _relative(plan: Plan, time: Float[Array, "K q"]) -> Float[Array, "n K q 6"]:
    """LVLH states at times since the start of each interval, s."""
    problem = plan.scenario.problem
    if plan.as_flown:
        return flown_between(plan.scenario.initial, plan.controls, problem, time)
    A, B = problem.dynamics.step(time, np.arange(problem.intervals)[:, None])
    return np.matvec(A, plan.states[:, :-1, None]) + np.matvec(B, plan.controls[:, :, None])


def _segment(plan: Plan, arcs: Arcs, craft: int, arc: int, name: str) -> Iterator[str]:
    thrust = " ".join(f"{u:.12e}" for u in plan.controls[craft, arc].tolist())
    epochs = [stamp(arcs.epoch, 1e-6 * each) for each in arcs.microseconds[arc].tolist()]
    yield from (
        "",
        "META_START",
        f"COMMENT Arc {arc + 1} of {len(arcs.microseconds)}. Constant thrust, m/s**2,",
        f"COMMENT radial, along-track and cross-track: {thrust}",
        *described(plan, craft, name),
        f"START_TIME = {epochs[0]}",
        f"STOP_TIME = {epochs[-1]}",
        "INTERPOLATION = HERMITE",
        f"INTERPOLATION_DEGREE = {DEGREE}",
        "META_STOP",
    )
    for epoch, state in zip(epochs, (arcs.states[craft, arc] / 1e3).tolist(), strict=True):
        position, velocity = state[:3], state[3:]
        numbers = [*(f"{p:.12f}" for p in position), *(f"{v:.15f}" for v in velocity)]
        yield f"{epoch} {' '.join(numbers)}"
