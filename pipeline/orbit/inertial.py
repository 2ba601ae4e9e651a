"""From the LVLH frame of the reference orbit to an inertial one."""

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.orbit.reference import Reference, radius_at


def inertial_states(
    states: Float[Array, "*batch 6"],
    time: Float[Array, "*#batch"],
    reference: Reference,
    mean_motion: float,
) -> Float[Array, "*batch 6"]:
    """States in EME2000 of craft beside a circular two-body orbit.

    The reference orbit's own state, radius r₀ and speed e r₀, is added to the relative one; the
    velocity gets the rotation of the LVLH frame too, e ẑ × (x, y, z) (Curtis, "Orbital Mechanics
    for Engineering Students", section 7.2). Nothing is approximated here, but relative states from
    linear dynamics stay as linear as they were.

    Args:
        states: x y z vx vy vz, LVLH, m and m/s.
        time: of each state, s since the reference's epoch.
        reference: where the reference orbit is.
        mean_motion: e, rad/s.

    Returns:
        Position and velocity in the Earth's mean equator and equinox of J2000, m and m/s.
    """
    e, r = mean_motion, radius_at(mean_motion)
    x, y, z, vx, vy, vz = np.moveaxis(states, -1, 0)
    position = np.stack([r + x, y, z], axis=-1)
    velocity = np.stack([vx - e * y, vy + e * (r + x), vz], axis=-1)
    axes = _lvlh_axes(time, reference, e)
    return np.concatenate([np.matvec(axes, position), np.matvec(axes, velocity)], axis=-1)


def _lvlh_axes(
    time: Float[Array, "*batch"], reference: Reference, mean_motion: float
) -> Float[Array, "*batch 3 3"]:
    """The radial, along-track and cross-track unit vectors as columns: Rz(Ω) Rx(i) Rz(u)."""
    i, raan, start = np.deg2rad(
        [reference.inclination_deg, reference.raan_deg, reference.argument_of_latitude_deg]
    )
    u = start + mean_motion * time
    node = np.array([np.cos(raan), np.sin(raan), 0.0])  # to the ascending node
    ahead = np.array(  # in the orbital plane, 90° ahead of it
        [-np.sin(raan) * np.cos(i), np.cos(raan) * np.cos(i), np.sin(i)]
    )
    cos, sin = np.cos(u)[..., None], np.sin(u)[..., None]
    radial, along = cos * node + sin * ahead, cos * ahead - sin * node
    cross = np.broadcast_to(np.cross(node, ahead), radial.shape)
    return np.stack([radial, along, cross], axis=-1)
