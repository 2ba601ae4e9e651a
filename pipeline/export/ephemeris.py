"""Orbit ephemeris messages (OEM 2.0, CCSDS 502.0-B) in keyword = value notation, one a craft."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from textwrap import wrap

import numpy as np
from jaxtyping import Float, Int

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.files import write_text
from pipeline.orbit.inertial import Elements, lvlh_frame
from pipeline.orbit.nonlinear import flown_between
from pipeline.orbit.reference import radius_at
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.plan import Plan
from pipeline.plan.judge import check_states
from pipeline.scenario.document import OrbitDocument
from pipeline.text import visible

FEWEST = 8  # states of an arc, so that readers that take eight for degree 7 find them
# Largest angle between states as the reference orbit turns, rad: polynomials of degree 7 through
# states this near miss a circle by less than 1e-6 of a metre at any altitude up to geostationary
SPACING = 0.05
DEGREE = 7  # of the Hermite interpolation that files ask for
LONGEST = 100  # characters of a comment on one line; messages have at most 254 on any
ORIGINATOR = "ORIGINATOR = PROLEARN"  # the line by which files of ours are known


def write_ephemerides(plan: Plan, folder: Path, name: str) -> list[Path]:
    """Write an OEM for each craft into a folder, a segment for each interval of constant thrust.

    Thrust jumps at nodes, and no interpolation may reach across a jump. Files of craft that an
    earlier plan had there, and this one has not, are removed. Objects are named by ``name``.
    """
    arcs, n = thrust_arcs(plan), plan.scenario.n
    created = _stamp(datetime.now(UTC))
    width, label = len(str(n - 1)), re.sub(r"[^A-Za-z0-9_.-]+", "-", name)
    paths = []
    for k in range(n):
        craft = f"craft-{k:0{width}d}"
        lines = [*_header(plan, k, created)]
        for arc in range(plan.scenario.problem.intervals):
            lines += _segment(plan, arcs, k, arc, f"{label}-{craft}")
        paths.append(folder / f"{craft}.oem")
        write_text(paths[-1], "\n".join(lines) + "\n")
    for old in folder.glob("craft-*.oem"):
        if old not in paths and ORIGINATOR in old.read_text(encoding="utf-8", errors="replace"):
            old.unlink()
    return paths


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
    problem, reference = plan.scenario.problem, plan.scenario.reference
    if reference is None:
        raise InputError(
            "the plan has no reference orbit; expected in its scenario "
            '"reference": {"epoch": "2026-03-01T12:00:00Z", "inclination_deg": 97.4, '
            '"raan_deg": 40, "argument_of_latitude_deg": 0} with your values: add it.'
        )
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
    relative = _relative(plan, time - start)
    if problem.orbit is not None:
        origin, frame = problem.orbit.frames(time)
        states = origin + frame.to_inertial(relative)
        return Arcs(reference.epoch, microseconds.astype(int), states)
    i, raan, latitude = np.deg2rad(
        [reference.inclination_deg, reference.raan_deg, reference.argument_of_latitude_deg]
    ).tolist()
    orbit = Elements(radius_at(problem.mean_motion), i, raan)
    origin = orbit.states(latitude + problem.mean_motion * time)
    frame = lvlh_frame(origin, np.zeros((*time.shape, 3)))  # two-body: the plane stays
    states = origin + frame.to_inertial(relative)
    return Arcs(reference.epoch, microseconds.astype(int), states)


def _relative(plan: Plan, time: Float[Array, "K q"]) -> Float[Array, "n K q 6"]:
    """LVLH states at times since the start of each interval, s."""
    problem = plan.scenario.problem
    if plan.as_flown:
        return flown_between(plan.scenario.initial, plan.controls, problem, time)
    A, B = problem.dynamics.step(time, np.arange(problem.intervals)[:, None])
    return np.matvec(A, plan.states[:, :-1, None]) + np.matvec(B, plan.controls[:, :, None])


def _header(plan: Plan, craft: int, created: str) -> Iterator[str]:
    problem = plan.scenario.problem
    planner = visible(plan.planner).encode("ascii", "replace").decode()
    about = f"Craft {craft} of {plan.scenario.n}, planned by {planner}: {plan.status}."
    about += " Craft are kept apart at the nodes only." * (plan.separation == "nodes")
    yield "CCSDS_OEM_VERS = 2.0"
    yield from (f"COMMENT {line}" for line in wrap(about, LONGEST))
    if problem.orbit is None:
        yield "COMMENT Relative motion is linear (Clohessy-Wiltshire). It was added to a circular"
        yield f"COMMENT two-body orbit of mean motion {problem.mean_motion!r} rad/s,"
        yield f"COMMENT radius {radius_at(problem.mean_motion) / 1e3:.9f} km."
    else:
        motion = "as flown in all terms" if plan.as_flown else "linear"
        yield f"COMMENT Relative motion is {motion}, about an orbit of osculating elements"
        yield from (f"COMMENT {line}" for line in wrap(_elements(problem.orbit), LONGEST))
    yield f"CREATION_DATE = {created}"
    yield ORIGINATOR


def _elements(orbit: ReferenceOrbit) -> str:
    """A reference orbit in a comment."""
    named = OrbitDocument.of(orbit).model_dump()
    return ", ".join(f"{name} {value}" for name, value in named.items()) + "."


def _segment(plan: Plan, arcs: Arcs, craft: int, arc: int, name: str) -> Iterator[str]:
    thrust = " ".join(f"{u:.12e}" for u in plan.controls[craft, arc].tolist())
    since = arcs.microseconds[arc].tolist()
    epochs = [_stamp(arcs.epoch + timedelta(microseconds=each)) for each in since]
    yield from (
        "",
        "META_START",
        f"COMMENT Arc {arc + 1} of {len(arcs.microseconds)}. Constant thrust, m/s**2,",
        f"COMMENT radial, along-track and cross-track: {thrust}",
        f"OBJECT_NAME = {name}",
        f"OBJECT_ID = {name}",
        "CENTER_NAME = EARTH",
        "REF_FRAME = EME2000",
        "TIME_SYSTEM = UTC",
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


def _stamp(time: datetime) -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%S.%f")
