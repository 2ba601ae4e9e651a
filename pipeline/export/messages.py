"""Orbit ephemeris and parameter messages (OEM 2.0, OPM 3.0; CCSDS 502.0-B): a file a craft."""

import re
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from textwrap import wrap

import numpy as np

from pipeline.arrays import Array, Float, Int
from pipeline.errors import InputError
from pipeline.export.inertial import reference_frames, reference_of, stamp
from pipeline.export.tables import Burns, Masses, burns_of
from pipeline.files import write_text
from pipeline.orbit.nonlinear import NonlinearFlight
from pipeline.orbit.reference import radius_at
from pipeline.plan.judge import check_states
from pipeline.plan.plan import Plan
from pipeline.scenario.part_documents import OrbitDocument
from pipeline.text import visible

LONGEST = 100  # characters of a comment's line, and of a plan's name; any line has at most 254
ORIGINATOR = "ORIGINATOR = PROLEARN"  # the line by which files of ours are known

FEWEST = 8  # states of an arc, so that readers that take eight for degree 7 find them
# Largest angle between states as the reference orbit turns, at perigee, rad: polynomials of degree
# 7 through states this near miss a circle by less than 1e-6 of a metre, up to geostationary
SPACING = 0.05
DEGREE = 7  # of the Hermite interpolation that files ask for

POINTS = 16  # of Gauss and Legendre in a revolution, or an interval that is shorter


def write_messages(
    folder: Path, suffix: str, n: int, message: Callable[[int], Iterable[str]]
) -> list[Path]:
    """Write the lines of a message for each of n craft, as ``craft-0`` and so on with a suffix.

    Files of craft that an earlier plan had there, and this one has not, are removed.
    """
    paths = [folder / f"{craft_name(k, n)}{suffix}" for k in range(n)]
    for k, path in enumerate(paths):
        write_text(path, "\n".join(message(k)) + "\n")
    for old in folder.glob(f"craft-*{suffix}"):
        if old not in paths and ORIGINATOR in old.read_text(encoding="utf-8", errors="replace"):
            old.unlink()
    return paths


def craft_name(craft: int, n: int) -> str:
    """Name of one of n craft, in as many digits as the last one has."""
    return f"craft-{craft:0{len(str(n - 1))}d}"


def header(version: str, plan: Plan, craft: int) -> Iterator[str]:
    """The first lines of a message: version, what it is about, and originator."""
    problem = plan.scenario.problem
    planner = visible(plan.planner).encode("ascii", "replace").decode()
    about = f"Craft {craft} of {plan.scenario.n}, planned by {planner}: {plan.status}."
    about += " Craft are kept apart at the nodes only." * (plan.separation == "nodes")
    yield version
    yield from _comments(about)
    if problem.orbit is None:
        yield "COMMENT Relative motion is linear (Clohessy-Wiltshire). It was added to a circular"
        yield f"COMMENT two-body orbit of mean motion {problem.mean_motion!r} rad/s,"
        yield f"COMMENT radius {radius_at(problem.mean_motion) / 1e3:.9f} km."
    else:
        motion = "as flown in all terms" if plan.as_flown else "linear"
        yield f"COMMENT Relative motion is {motion}, about an orbit of osculating elements"
        named = OrbitDocument.of(problem.orbit).model_dump()
        yield from _comments(", ".join(f"{name} {value}" for name, value in named.items()) + ".")
    yield f"CREATION_DATE = {stamp(datetime.now(UTC))}"
    yield ORIGINATOR


def metadata(plan: Plan, craft: int, name: str) -> Iterator[str]:
    """The metadata of a craft: object, frame and time system."""
    label = re.sub(r"[^A-Za-z0-9_.-]+", "-", name)[:LONGEST]
    whole = f"{label}-{craft_name(craft, plan.scenario.n)}"
    yield f"OBJECT_NAME = {whole}"
    yield f"OBJECT_ID = {whole}"
    yield "CENTER_NAME = EARTH"
    yield "REF_FRAME = EME2000"
    yield "TIME_SYSTEM = UTC"


def _comments(text: str) -> list[str]:
    return [f"COMMENT {line}" for line in wrap(text, LONGEST)]


def write_ephemerides(plan: Plan, folder: Path, name: str) -> list[Path]:
    """Write an OEM for each craft into a folder, a segment for each interval of constant thrust.

    No interpolation may reach across a node, where thrust jumps. Objects are named by ``name``.
    """
    start = reference_of(plan.scenario).epoch
    microseconds, states = thrust_arcs(plan)

    def message(craft: int) -> Iterator[str]:
        yield from header("CCSDS_OEM_VERS = 2.0", plan, craft)
        for arc, times in enumerate(microseconds.tolist()):
            thrust = " ".join(f"{u:.12e}" for u in plan.controls[craft, arc].tolist())
            epochs = [stamp(start, 1e-6 * each) for each in times]
            yield from (
                "",
                "META_START",
                f"COMMENT Arc {arc + 1} of {len(microseconds)}. Constant thrust, m/s**2,",
                f"COMMENT radial, along-track and cross-track: {thrust}",
                *metadata(plan, craft, name),
                f"START_TIME = {epochs[0]}",
                f"STOP_TIME = {epochs[-1]}",
                "INTERPOLATION = HERMITE",
                f"INTERPOLATION_DEGREE = {DEGREE}",
                "META_STOP",
            )
            for epoch, state in zip(epochs, (states[craft, arc] / 1e3).tolist(), strict=True):
                numbers = [*(f"{p:.12f}" for p in state[:3]), *(f"{v:.15f}" for v in state[3:])]
                yield f"{epoch} {' '.join(numbers)}"

    return write_messages(folder, ".oem", plan.scenario.n, message)


def thrust_arcs(
    plan: Plan,
) -> tuple[Int[Array, "intervals q"], Float[Array, "n intervals q 6"]]:
    """The arcs of a plan under constant thrust, sampled densely enough to interpolate.

    Times are whole microseconds since the first node; an arc ends when the next begins. States are
    those at these very times, in EME2000, m and m/s. InputError for states that are not what the
    controls lead to, or for nodes too near each other.
    """
    problem = plan.scenario.problem
    check_states(plan)
    steps = max(FEWEST - 1, int(np.ceil(problem.dynamics.fastest * problem.time_step / SPACING)))
    start = problem.time_step * np.arange(problem.intervals)[:, None]
    microseconds = np.rint(1e6 * (start + problem.time_step * np.arange(steps + 1) / steps))
    if np.diff(microseconds).min() < 1:
        raise InputError(
            f"time_step is {problem.time_step:g} s; expected at least {FEWEST} microseconds, which "
            "is what epochs in a file tell apart."
        )
    time = microseconds * 1e-6
    origin, frame = reference_frames(plan.scenario, time)
    return microseconds.astype(int), origin + frame.to_inertial(_relative(plan, time - start))


def _relative(plan: Plan, time: Float[Array, "K q"]) -> Float[Array, "n K q 6"]:
    """LVLH states at times since the start of each interval, s."""
    problem = plan.scenario.problem
    if plan.as_flown:
        return NonlinearFlight(plan.scenario.initial, plan.controls, problem).between(time)
    A, B = problem.dynamics.step(time, np.arange(problem.intervals)[:, None])
    return np.matvec(A, plan.states[:, :-1, None]) + np.matvec(B, plan.controls[:, :, None])


def write_orbit_parameters(plan: Plan, folder: Path, name: str, masses: Masses) -> list[Path]:
    """Write an OPM for each craft into a folder: its state at the first node, mass and burns.

    A manoeuvre is the velocity that a burn adds, in EME2000. Objects are named by ``name``.
    InputError without a reference orbit, for burns without masses or a specific impulse, or for
    states that are not what the controls lead to.
    """
    epoch = reference_of(plan.scenario).epoch
    burns, scenario = burns_of(plan, masses), plan.scenario
    if np.isnan(burns.propellant).any():
        what = "masses of the craft are" if np.isnan(burns.mass).any() else "specific impulse is"
        raise InputError(
            f"the {what} not known, and a manoeuvre in an OPM says what mass it takes; expected "
            "mass (kg) and specific_impulse (s), such as 12 and 220."
        )
    origin, frame = reference_frames(scenario, np.zeros(scenario.n))
    states = origin + frame.to_inertial(scenario.initial)
    added = _velocities(plan, burns)

    def message(craft: int) -> Iterator[str]:
        yield from header("CCSDS_OPM_VERS = 3.0", plan, craft)
        yield from metadata(plan, craft, name)
        yield f"EPOCH = {stamp(epoch)}"
        keys = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
        for key, value in zip(keys, (states[craft] / 1e3).tolist(), strict=True):
            yield f"{key} = {value:.15g}"
        if not np.isnan(masses.mass[craft]):
            yield f"MASS = {masses.mass[craft]:.15g}"
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
    """What burns add to inertial velocities, m/s: integrals of accelerations in a turning frame."""
    problem = plan.scenario.problem
    points, weights = np.polynomial.legendre.leggauss(POINTS)
    pieces = int(np.ceil(problem.dynamics.fastest * problem.time_step / (2 * np.pi)))
    share = (np.arange(problem.intervals * pieces)[:, None] + (1 + points) / 2) / pieces
    turned = reference_frames(plan.scenario, problem.time_step * share)[1].axes
    mean = np.tensordot(turned, weights / 2, axes=(1, 0)).reshape(-1, pieces, 3, 3).mean(axis=1)
    return problem.time_step * np.matvec(mean[burns.interval], burns.acceleration)
