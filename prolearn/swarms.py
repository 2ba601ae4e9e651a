"""Scenarios from rings, from states or from files."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any, NotRequired, TypedDict

import numpy as np
from pydantic_core import to_jsonable_python

from pipeline.arrays import Array, as_lists
from pipeline.errors import check_kind
from pipeline.files import path_of
from pipeline.orbit.corridors import Corridor
from pipeline.orbit.participants import Obstacle
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import Reference, utc_epoch
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.thrust import ALONG_AXES, Thrust
from pipeline.scenario import Scenario
from pipeline.scenario.document import scenario_from
from pipeline.scenario.inertial import read_inertial, scenario_from_inertial
from pipeline.scenario.part_documents import OrbitDocument
from pipeline.scenario.scenario import EndKind
from pipeline.scenario.spacecraft import Spacecraft
from pipeline.scenario.waypoint import Waypoint


class Ring(TypedDict):
    """Craft on one passive relative orbit, a 2:1 ellipse that closes by itself; a dictionary.

    x = (size/2) cos θ, y = offset - size sin θ, z = (size/2) tan(tilt) cos(θ + cross phase), with
    the phase θ growing at the mean motion; about another orbit than a circle, the bounded motion
    with the same mean relative orbital elements. Only the size is needed, and craft or phases.

    Attributes:
        size: half the ring's along-track extent, its radial one, m.
        craft: number of craft, equally spaced in phase.
        first_phase_deg: phase of the first of them, deg.
        phases_deg: instead of both, the phase of each craft, deg.
        tilt_deg: its tangent is cross-track extent over radial one; at a cross phase of 0 the angle
            of the ring's plane to the orbital plane, deg.
        cross_phase_deg: phase between cross-track and radial motion, deg.
        offset: along-track distance of the ring's centre from the origin, m.
    """

    size: float
    craft: NotRequired[int]
    first_phase_deg: NotRequired[float]
    phases_deg: NotRequired[Sequence[float]]
    tilt_deg: NotRequired[float]
    cross_phase_deg: NotRequired[float]
    offset: NotRequired[float]


def scenario(
    initial: Ring | Sequence[Ring] | Sequence[Sequence[float]] | Array,
    goal: Ring | Sequence[Ring] | Sequence[Sequence[float]] | Array,
    *,
    altitude: float | None = None,
    orbit: ReferenceOrbit | None = None,
    ends: EndKind = "passive",
    time_step: float = Problem.time_step,
    nodes: int = Problem.nodes,
    collision_radius: float = Problem.collision_radius,
    max_acceleration: float | None = None,
    thrust: Thrust = ALONG_AXES,
    craft: Sequence[Spacecraft] = (),
    obstacles: Sequence[Obstacle] = (),
    corridors: Sequence[Corridor] = (),
    waypoints: Sequence[Waypoint] = (),
    reference: Reference | None = None,
    name: str = "",
) -> Scenario:
    """A scenario from rings or states (m, m/s, LVLH) at either end.

    Args:
        initial: a ring, or several, whose craft follow on, or a row x y z vx vy vz for each craft.
        goal: likewise, of the same craft in the same order.
        altitude: of the circular reference orbit, m; by default 500 km.
        orbit: instead, one that is no circle or has perturbations.
        ends: passive, on orbits that do not drift, or any.
        time_step: length of an interval of constant control, s.
        nodes: time nodes, one more than intervals.
        collision_radius: craft must be further apart at all times, m.
        max_acceleration: limit on each component of the control, m/s², or None.
        thrust: thrusters along the axes, one that is pointed or of given directions, limits of the
            norm, the minimum impulse bit, windows without burns, and the objective.
        craft: what each craft has of its own, as its radius; none where all are alike.
        obstacles: bodies that craft keep clear of, and whose motion no plan changes.
        corridors: boxes and approach cones that craft stay inside of for some time.
        waypoints: places that craft must pass on their way.
        reference: where and when the orbit is, for ephemerides and for flights about the Earth.
        name: in tables and figures; of a file that is read, the file's name.

    Raises:
        InputError: naming the field that is missing or wrong.
    """
    check_kind("orbit", orbit, ReferenceOrbit | None)
    fields = {
        "mean_motion": Problem.mean_motion if altitude is None and orbit is None else None,
        "altitude": altitude,
        "orbit": orbit and OrbitDocument.of(orbit),
        "ends": ends,
        "time_step": time_step,
        "nodes": nodes,
        "collision_radius": collision_radius,
        "max_acceleration": max_acceleration,
        "initial": _end(initial),
        "goal": _end(goal),
    }
    made = scenario_from({field: as_lists(one) for field, one in fields.items()}, name)
    return replace(
        made,
        problem=replace(made.problem, thrust=thrust),
        craft=craft,
        obstacles=obstacles,
        corridors=corridors,
        waypoints=waypoints,
        reference=reference,
    )


def scenario_from_files(
    initial: Path | str,
    goal: Path | str,
    *,
    chief: Path | str | None = None,
    epoch: datetime | None = None,
    time_step: float = Problem.time_step,
    nodes: int = Problem.nodes,
    collision_radius: float = Problem.collision_radius,
    max_acceleration: float | None = None,
    thrust: Thrust = ALONG_AXES,
    craft: Sequence[Spacecraft] = (),
    j2: bool = True,
    ballistic: float | None = None,
    spread: float = 0.0,
    name: str = "",
) -> Scenario:
    """A scenario from files of inertial states, as `prolearn scenario new --initial` makes it.

    A file is a folder of orbit ephemeris messages (OEM), one of these, or a table of states or of
    osculating elements. docs/files.md says what they may have.

    Args:
        initial: where craft are at the first node.
        goal: where they must be at the last node, in the same order.
        chief: the one craft whose orbit is the reference; by default the mean of the craft.
        epoch: of the first node, with its zone; by default the first with all ephemerides.
        time_step: length of an interval of constant control, s.
        nodes: time nodes, one more than intervals.
        collision_radius: craft must be further apart at all times, m.
        max_acceleration: limit on each component of the control, m/s², or None.
        thrust: as of ``scenario``.
        craft: what each craft has of its own; none where all are alike.
        j2: whether the Earth is oblate.
        ballistic: mean C_D A/m of the swarm, m²/kg, or None for no drag.
        spread: relative spread of C_D A/m over the swarm: the first craft less, the last more.
        name: in tables and figures; of a file that is read, the file's name.

    Raises:
        InputError: naming the file, and what is wrong with it.
    """
    grid = Problem(Problem.mean_motion, time_step, nodes, collision_radius, max_acceleration)
    at = None if epoch is None else utc_epoch(epoch)
    read = cache(read_inertial)  # one file may be all three, and standard input is there once
    made = scenario_from_inertial(
        read(path_of(initial)),
        read(path_of(goal)),
        grid,
        chief=None if chief is None else read(path_of(chief)),
        epoch=at,
        j2=j2,
        ballistic=ballistic,
        spread=spread,
    )
    problem = replace(made.problem, thrust=thrust)
    return replace(made, problem=problem, name=name, craft=craft)


def _end(given: Any) -> Any:
    """Rings or states as in a file, without numpy's arrays and numbers."""
    lone = isinstance(given, Mapping) and "rings" not in given
    plain = to_jsonable_python([given] if lone else given, fallback=_listed)
    rings = isinstance(plain, list) and any(isinstance(one, Mapping) for one in plain)
    return {"rings": plain} if rings else plain


def _listed(given: Any) -> Any:
    """A value that is not JSON: an array as lists and numbers, anything else as text."""
    plain = as_lists(given)
    if isinstance(plain, np.floating):  # a long double, which lists as itself
        return float(plain)
    return repr(plain) if plain is given or isinstance(plain, np.generic) else plain
