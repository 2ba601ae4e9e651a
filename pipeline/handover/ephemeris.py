"""Orbit ephemeris messages (OEM 2.0, CCSDS 502.0-B) in keyword = value notation, one a craft."""

import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from textwrap import wrap

from pipeline.files import write_text
from pipeline.handover.arcs import Arcs, thrust_arcs
from pipeline.orbit.reference import Reference, radius_at
from pipeline.plan import Plan
from pipeline.scenario import Scenario
from pipeline.text import visible

DEGREE = 7
"""Of the Hermite interpolation that files ask for."""

LONGEST = 100
"""Characters of a comment on one line; messages have at most 254 on any."""


ORIGINATOR = "ORIGINATOR = PROLEARN"
"""The line by which files of ours are known."""


def write_ephemerides(plan: Plan, scenario: Scenario, folder: Path, name: str) -> list[Path]:
    """Write an OEM for each craft into a folder, a segment for each interval of constant thrust.

    Thrust jumps at nodes, and no interpolation may reach across a jump. Files of craft that an
    earlier plan had there, and this one has not, go.

    Args:
        plan: whose states and controls.
        scenario: what it is for, with its reference orbit.
        folder: where the files go, as craft-0.oem and so on.
        name: of the plan, which objects are named by.

    Raises:
        InputError: where the scenario has no reference orbit, or the plan's states are not what
            its controls lead to.
    """
    arcs = thrust_arcs(plan, scenario)
    created = _stamp(datetime.now(UTC))
    width, label = len(str(scenario.n - 1)), re.sub(r"[^A-Za-z0-9_.-]+", "-", name)
    paths = []
    for k in range(scenario.n):
        craft = f"craft-{k:0{width}d}"
        lines = [*_header(plan, scenario, k, created)]
        for arc in range(scenario.problem.intervals):
            lines += _segment(plan, scenario, arcs, k, arc, f"{label}-{craft}")
        paths.append(folder / f"{craft}.oem")
        write_text(paths[-1], "\n".join(lines) + "\n")
    for old in folder.glob("craft-*.oem"):
        if old not in paths and ORIGINATOR in old.read_text(encoding="utf-8", errors="replace"):
            old.unlink()
    return paths


def _header(plan: Plan, scenario: Scenario, craft: int, created: str) -> Iterator[str]:
    problem = scenario.problem
    planner = visible(plan.planner).encode("ascii", "replace").decode()
    about = f"Craft {craft} of {scenario.n}, planned by {planner}: {plan.status}."
    about += " Craft are kept apart at the nodes only." * (plan.separation == "nodes")
    yield "CCSDS_OEM_VERS = 2.0"
    yield from (f"COMMENT {line}" for line in wrap(about, LONGEST))
    yield "COMMENT Relative motion is linear (Clohessy-Wiltshire). It was added to a circular"
    yield f"COMMENT two-body orbit of mean motion {problem.mean_motion!r} rad/s,"
    yield f"COMMENT radius {radius_at(problem.mean_motion) / 1e3:.9f} km."
    yield f"CREATION_DATE = {created}"
    yield ORIGINATOR


def _segment(
    plan: Plan, scenario: Scenario, arcs: Arcs, craft: int, arc: int, name: str
) -> Iterator[str]:
    thrust = " ".join(f"{u:.12e}" for u in plan.controls[craft, arc].tolist())
    epochs = _epochs(scenario.reference, arcs.microseconds[arc].tolist())
    yield ""
    yield "META_START"
    yield f"COMMENT Arc {arc + 1} of {scenario.problem.intervals}. Constant thrust, m/s**2,"
    yield f"COMMENT radial, along-track and cross-track: {thrust}"
    yield f"OBJECT_NAME = {name}"
    yield f"OBJECT_ID = {name}"
    yield "CENTER_NAME = EARTH"
    yield "REF_FRAME = EME2000"
    yield "TIME_SYSTEM = UTC"
    yield f"START_TIME = {epochs[0]}"
    yield f"STOP_TIME = {epochs[-1]}"
    yield "INTERPOLATION = HERMITE"
    yield f"INTERPOLATION_DEGREE = {DEGREE}"
    yield "META_STOP"
    for epoch, state in zip(epochs, (arcs.states[craft, arc] / 1e3).tolist(), strict=True):
        position, velocity = state[:3], state[3:]
        numbers = [*(f"{p:.12f}" for p in position), *(f"{v:.15f}" for v in velocity)]
        yield f"{epoch} {' '.join(numbers)}"


def _epochs(reference: Reference | None, microseconds: list[int]) -> list[str]:
    assert reference is not None  # without one there are no arcs
    return [_stamp(reference.epoch + timedelta(microseconds=each)) for each in microseconds]


def _stamp(time: datetime) -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%S.%f")
