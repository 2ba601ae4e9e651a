"""Scenarios from files of inertial states: ephemerides (OEM), tables of states or of elements."""

import csv
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.documents import MOST_BYTES, parse_unique_json
from pipeline.errors import InputError, error_context, is_number
from pipeline.files import read_bytes
from pipeline.orbit.arrays import Formation
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import HIGHEST, R_EARTH, Reference
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.scenario.document import document_of, scenario_from
from pipeline.scenario.oem import FIRST_LINE, LARGEST, Ephemeris, ephemeris_from
from pipeline.scenario.part_documents import ANGLES
from pipeline.scenario.scenario import MOST_CRAFT, Scenario
from pipeline.scenario.validation import drifts
from pipeline.text import visible

EXACT = 1e-6  # largest error of states turned to LVLH and back, m; of velocities 1e-9 m/s
METRES = ("x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s")
KILOMETRES = ("x_km", "y_km", "z_km", "vx_km_s", "vy_km_s", "vz_km_s")
ELEMENTS = (
    "semi_major_axis",
    "eccentricity",
    "inclination_deg",
    "raan_deg",
    "argument_of_perigee_deg",
    "argument_of_latitude_deg",
)
LABEL = "craft"  # an optional column, which is not read
COLUMNS = " or ".join(",".join(columns) for columns in (METRES, KILOMETRES, ELEMENTS))
WHAT = "a folder of OEM files, one of these, or a table (CSV or JSON) of states or elements"
MORE = "..."  # key of values beyond the columns
TABLE_FRAME = "EME2000"


@dataclass(frozen=True, eq=False)
class Inertial:
    """Inertial states of some craft: ephemerides over time, or a table for one time."""

    name: str  # of the file or folder
    frame: str
    craft: tuple[Ephemeris, ...] | Formation

    @property
    def start(self) -> datetime | None:
        """The first time at which all craft have a state, where times are known."""
        return max(one.start for one in self.craft) if isinstance(self.craft, tuple) else None

    def states(self, epoch: datetime | None, seconds: float) -> Formation:
        """States so many seconds after an epoch, m and m/s; those of a table at any time."""
        if not isinstance(self.craft, tuple):
            found = self.craft
        elif epoch is None:
            raise InputError(
                f"{self.name} has states over time; expected to know when the first node is: give "
                "its epoch."
            )
        else:
            found = np.array([one.state_at(epoch, seconds) for one in self.craft])
        radius = np.linalg.norm(found[:, :3], axis=1)
        for k in np.flatnonzero((radius < R_EARTH) | (radius > R_EARTH + HIGHEST)):
            raise InputError(
                f"{self.name} has craft {k} {radius[k] / 1e3:.6g} km from the Earth's centre; "
                f"expected {R_EARTH / 1e3:g} to {(R_EARTH + HIGHEST) / 1e3:g} km: is its unit the "
                "one that the file names?"
            )
        return found


def read_inertial(path: Path) -> Inertial:
    """The states in a folder of OEM files, in one of these or in a table.

    Craft of a folder are in the order of the files' names, numbers in these by their value.
    InputErrors name the file and what is wrong with it.
    """
    if path.is_dir():
        files = sorted(path.glob("*.oem"), key=_by_number)
        if not 1 <= len(files) <= MOST_CRAFT:
            raise InputError(
                f"{path} has {len(files)} files whose names end in .oem; expected 1 to "
                f"{MOST_CRAFT}."
            )
        found = [ephemeris_from(_text(file), str(file)) for file in files]
    else:
        text = _text(path)  # once, since a pipe or standard input cannot be read again
        if not text.lstrip().startswith(FIRST_LINE):
            return Inertial(str(path), TABLE_FRAME, _table(text, str(path)))
        found = [ephemeris_from(text, str(path))]
    check_frames(found)
    return Inertial(str(path), found[0].frame, tuple(found))


def check_frames(given: Sequence[Inertial | Ephemeris]) -> None:
    """Refuse states in several frames, which differ by up to a metre."""
    frames = {one.frame: one.name for one in given}
    if len(frames) > 1:
        several = " and ".join(f"{name} in {frame}" for frame, name in frames.items())
        raise InputError(f"there are states of {several}; expected one frame for all.")


def _by_number(path: Path) -> list[tuple[int, str]]:
    return [
        (int(part), "") if part.isdecimal() else (0, part) for part in re.split(r"(\d+)", path.name)
    ]


def _text(path: Path) -> str:
    try:
        return read_bytes(path, MOST_BYTES).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read ({error}); expected {WHAT}.") from error


def _table(text: str, name: str) -> Formation:
    """Inertial states read from a table, m and m/s."""
    rows = _json_rows(text, name) if text.lstrip()[:1] in ("[", "{") else _csv_rows(text, name)
    if not 1 <= len(rows) <= MOST_CRAFT:
        raise InputError(f"{name} has {len(rows)} rows; expected {WHAT}, of 1 to {MOST_CRAFT}.")
    given = {column for column in rows[0] if column not in (LABEL, MORE)}
    columns = next((one for one in (METRES, KILOMETRES, ELEMENTS) if given == {*one}), None)
    if columns is None:
        shown = visible(",".join(map(str, rows[0])))[:200]
        raise InputError(f"{name} has the columns {shown}; expected {COLUMNS}.")
    return np.stack([_state(row, columns, f"{name}: row {k + 1}") for k, row in enumerate(rows)])


def _csv_rows(text: str, name: str) -> list[dict[str, Any]]:
    """Rows by column, with numbers parsed; lines that begin with # are comments."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    try:
        names = [column.strip() for column in next(csv.reader(lines[:1]), [])]
        rows = [*csv.DictReader(lines[1:], names, restkey=MORE, restval="")]
    except csv.Error as error:
        raise InputError(f"{name} is not CSV: {error}; expected {WHAT}.") from error
    if len({*names}) < len(names):
        raise InputError(f"{name} has a column twice; expected each once.")
    return [{column: _number(value) for column, value in row.items()} for row in rows]


def _number(text: Any) -> Any:
    with suppress(ValueError, TypeError):
        return float(text)
    return text


def _json_rows(text: str, name: str) -> list[dict[str, Any]]:
    try:
        with error_context(name):
            rows = parse_unique_json(text.encode())
    except ValueError as error:
        raise InputError(f"{name} is not JSON: {error}; expected {WHAT}.") from error
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(f"{name} is no list of objects; expected one for each craft, in [].")
    return rows


def _state(row: Mapping[str, Any], columns: Sequence[str], where: str) -> Float[Array, "6"]:
    """The state of a row, m and m/s."""
    if {*row} - {LABEL} != {*columns}:
        raise InputError(f"{where} has {len(row)} values; expected {','.join(columns)}.")
    for column in columns:
        value = row[column]
        if not is_number(value) or not abs(value) < LARGEST:
            shown = visible(repr(value))[:60]
            raise InputError(f"{where} has {column} {shown}; expected a number.")
    numbers = np.array([row[column] for column in columns], dtype=float)
    if columns == ELEMENTS:
        with error_context(where):
            orbit = ReferenceOrbit(*numbers.tolist())
        return np.asarray(orbit.states(np.zeros(1))[0])
    return 1e3 * numbers if columns == KILOMETRES else numbers


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
    mean of the craft's states there, and is integrated to the last node. It replaces the orbit of
    the problem.

    The epoch of the first node, UTC, is by default the first at which all ephemerides of initial
    states and chief have a state. ``ballistic`` is the mean C_D A/m of the swarm, m²/kg, and
    ``spread`` its relative spread: the first craft has less, the last more. InputError where
    states are missing, in several frames, or not near the reference orbit.
    """
    given = [one for one in (initial, chief, goal) if one is not None]
    check_frames(given)
    starts = [one.start for one in (initial, chief) if one is not None and one.start is not None]
    epoch = epoch or max(starts, default=None)
    first, last = initial.states(epoch, 0.0), goal.states(epoch, problem.duration)
    chiefs = first if chief is None else chief.states(epoch, 0.0)
    if chief is not None and len(chiefs) != 1:
        raise InputError(f"{chief.name} has {len(chiefs)} craft; expected one, the chief.")
    mean = chiefs.mean(axis=0)
    orbit = ReferenceOrbit.through(mean, j2=j2, ballistic=ballistic, spread=spread)
    problem = problem.about(orbit)
    start, end = _relative(first, orbit, 0.0), _relative(last, orbit, problem.duration)
    angles = (getattr(orbit, name) for name in ANGLES)
    reference = None if epoch is None else Reference(epoch, *angles)
    scenario = Scenario(problem, start, end, reference=reference)
    scenario = replace(scenario, ends="any" if drifts(scenario) else "passive")
    _check_inverse(scenario, first, last)
    return scenario


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
