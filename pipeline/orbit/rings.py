"""Rings: bounded relative orbits without thrust, about a circle and about any reference orbit.

About a circle they are passive relative orbits (PROs). About others they have the same quasi-
nonsingular relative orbital elements, differences of mean elements: in semi-major axis δa, mean
longitude δλ, the vector of eccentricity (δex, δey) and the direction of the orbital plane (δix,
δiy), all as shares of the semi-major axis (D'Amico 2010, "Autonomous formation flying in low Earth
orbit"; Koenig, Guffanti and D'Amico 2017, "New state transition matrices for spacecraft relative
motion in perturbed orbits"). Here their axes are the LVLH axes of the mean reference.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.orbit import mean_elements
from pipeline.orbit.arrays import AnyState, Formation, PerCraft, Scalar, norm
from pipeline.orbit.dynamics import cw_matrices
from pipeline.orbit.inertial import Frame
from pipeline.orbit.mean_elements import PlanarElements
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import MU_EARTH
from pipeline.orbit.reference_orbit import ReferenceOrbit

DRIFT_FREE = 1e-6  # relative misfit of Eq. 3 up to which states lie on passive relative orbits
LIKE = 0.1  # relative difference of semi-major axes, and margin of eccentricities below 1
NEWTON = 4  # iterations for δa, which converge about quadratically

OneOrEach = float | Float[Array, "#n"]  # of all craft, or of each


def pro_states(
    semi_major_axis: OneOrEach,
    tilt: OneOrEach,
    phase: PerCraft,
    cross_phase: OneOrEach,
    mean_motion: float,
    offset: OneOrEach = 0.0,
) -> Formation:
    """LVLH states (m, m/s) of craft on 2:1 relative orbits, bounded since they satisfy Eq. 3.

    x = (a/2) cos θ, y = offset - a sin θ, z = (a/2) tan(i) cos(θ + φ), with the phase θ of each
    craft growing at the mean motion, rad/s. The semi-major axis a is half the ring's along-track
    extent, m. The tilt i, rad, has the ring's cross-track extent over its radial one as tangent; it
    is the angle of its plane to the orbital plane where the cross phase φ, rad, between cross-track
    and radial motion is 0. The offset is of its centre, along-track, m.
    """
    a, e, theta = semi_major_axis, mean_motion, phase
    height = a / 2 * np.tan(tilt)
    columns = (
        a / 2 * np.cos(theta),
        offset - a * np.sin(theta),
        height * np.cos(theta + cross_phase),
        -a / 2 * e * np.sin(theta),
        -a * e * np.cos(theta),
        -height * e * np.sin(theta + cross_phase),
    )
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


def energy_mismatch(states: AnyState, mean_motion: float) -> Scalar:
    """ẏ + 2e x in m/s, which is 0 by Eq. 3: otherwise the craft drifts along-track."""
    return states[..., 4] + 2 * mean_motion * states[..., 0]


def revolution(states: Formation, points: int) -> Float[Array, "n _ 3"] | None:
    """Positions, m, over one revolution of free drift from states on PROs; None for others."""
    # The mean motion follows from Eq. 3, ẏ = -2e x, with one e for all.
    x, vy = states[:, 0], states[:, 4]
    mean_motion = -float(vy @ x) / (2 * float(x @ x)) if x.any() else 0.0
    misfit = np.abs(energy_mismatch(states, mean_motion)).max()
    if mean_motion <= 0 or misfit > DRIFT_FREE * np.abs(vy).max():
        return None
    A, _ = cw_matrices(mean_motion, np.linspace(0, 2 * np.pi / mean_motion, points))
    return np.einsum("kij,nj->nki", A[:, :3], states)


def ring_states(
    problem: Problem,
    semi_major_axis: OneOrEach,
    tilt: OneOrEach,
    phase: PerCraft,
    cross_phase: OneOrEach = 0.0,
    offset: OneOrEach = 0.0,
) -> Formation:
    """LVLH states (m, m/s) at the first node of craft on a ring, as ``pro_states`` has it.

    About an orbit of its own they have the same relative elements: δe = a/2 at θ behind the mean
    longitude, δi = a/2 tan(i), δλ the offset, and δa such that along-track positions do not drift
    on average over revolutions. So the motion is bounded, and close to the ring's shape where the
    orbit is close to a circle.
    """
    orbit = problem.orbit
    if orbit is None:
        return pro_states(semi_major_axis, tilt, phase, cross_phase, problem.mean_motion, offset)
    origin, chief, frame = _reference(orbit)
    size = chief.semi_major_axis
    behind = chief.longitude - phase
    e, i = semi_major_axis / 2 / size, semi_major_axis / 2 / size * np.tan(tilt)
    across = behind - cross_phase - np.pi / 2
    shape = 0.0, -e * np.cos(behind), -e * np.sin(behind), offset / size
    columns = np.broadcast_arrays(*shape, i * np.cos(across), i * np.sin(across))
    by = np.stack(columns, axis=-1)
    craft = chief[np.zeros(len(by), dtype=int)].changed(by)  # the reference, once for every craft
    for _ in range(NEWTON):
        ahead = _relative_rate(orbit, craft.states(), chief)
        longer = ahead / (1.5 * craft.mean_motion * np.sqrt(1 - chief.eccentricity_squared))
        craft = replace(craft, semi_major_axis=craft.semi_major_axis + longer)
    states = mean_elements.osculating_states(craft.states(), j2=orbit.j2)
    return frame.from_inertial(states - origin)


def secular_drift(states: Formation, problem: Problem) -> PerCraft:
    """Along-track drift of LVLH states at the first node, m a revolution of a reference orbit.

    For positions averaged over revolutions, by Kepler's laws and to first order in J2; by the
    energy alone for craft whose orbit differs much from the reference's.
    """
    orbit = problem.orbit
    assert orbit is not None
    origin, chief, frame = _reference(orbit)
    craft = origin + frame.to_inertial(states)
    size, n = chief.semi_major_axis, chief.mean_motion
    r, v, h = norm(craft[:, :3]), norm(craft[:, 3:]), norm(np.cross(craft[:, :3], craft[:, 3:]))
    share = size * (2 / r - v**2 / MU_EARTH)  # of the reference's semi-major axis in the craft's
    square = 1 - h**2 * share / (MU_EARTH * size)  # of the eccentricity
    like = (np.abs(share - 1) < LIKE) & (square < (1 - LIKE) ** 2)
    drift = 3 * np.pi * size * (share - 1) * np.sqrt(1 - chief.eccentricity_squared)
    mean = mean_elements.mean_states(craft[like], j2=orbit.j2)
    drift[like] = 2 * np.pi / n * _relative_rate(orbit, mean, chief)
    return drift


@lru_cache(maxsize=32)
def _reference(orbit: ReferenceOrbit) -> tuple[Float[Array, "1 6"], PlanarElements, Frame]:
    """Inertial state and mean elements of the reference at the first node, and its LVLH frame."""
    origin, frame = orbit.frames(np.zeros(1))
    mean = mean_elements.mean_states(origin, j2=orbit.j2)
    return origin, PlanarElements.of(mean), frame


def _relative_rate(orbit: ReferenceOrbit, mean: Formation, chief: PlanarElements) -> PerCraft:
    """Secular along-track rate of mean states relative to a mean reference, averaged, m/s.

    A rotation of the orbit in its plane, Δω + ΔΩ cos i, moves a craft by that times r, on average
    by a (1 + e²/2); ΔM by a²√(1-e²)/r, on average a √(1-e²).
    """
    both = PlanarElements.of(mean), chief
    rates = (mean_elements.secular_rates(one, j2=orbit.j2) for one in both)
    perigee, anomaly, node = (craft - its for craft, its in zip(*rates, strict=True))
    square, cos = chief.eccentricity_squared, chief.axes[:, 2, 2]
    turned = (1 + square / 2) * (perigee + cos * node)
    return chief.semi_major_axis * (turned + np.sqrt(1 - square) * anomaly)
