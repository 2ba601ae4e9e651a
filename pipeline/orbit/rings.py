"""Passive relative orbits (PROs): bounded motions about the reference orbit without thrust."""

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.orbit.arrays import AnyState, Formation, OfCraft, Scalar
from pipeline.orbit.dynamics import cw_matrices

DRIFT_FREE = 1e-6  # relative misfit of Eq. 3 up to which states lie on passive relative orbits


def pro_states(
    semi_major_axis: float | Float[Array, "#n"],
    tilt: float | Float[Array, "#n"],
    phase: OfCraft,
    cross_phase: float | Float[Array, "#n"],
    mean_motion: float,
    offset: float | Float[Array, "#n"] = 0.0,
) -> Formation:
    """LVLH states (m, m/s) of craft on 2:1 relative orbits, bounded since they satisfy Eq. 3.

    x = (a/2) cos θ, y = offset - a sin θ, z = (a/2) tan(i) cos(θ + φ), with the phase θ of each
    craft growing at the mean motion, rad/s. The semi-major axis a is half the ring's along-track
    extent, m; the tilt i of its plane is against the orbital plane, rad; the cross phase φ, rad, is
    between cross-track and radial motion; the offset is of its centre, along-track, m.
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
    """Positions in m over one revolution of free drift through states on PROs; None if on none."""
    # The mean motion follows from Eq. 3, ẏ = -2e x, with one e for all.
    x, vy = states[:, 0], states[:, 4]
    mean_motion = -float(vy @ x) / (2 * float(x @ x)) if x.any() else 0.0
    misfit = np.abs(energy_mismatch(states, mean_motion)).max()
    if mean_motion <= 0 or misfit > DRIFT_FREE * np.abs(vy).max():
        return None
    A, _ = cw_matrices(mean_motion, np.linspace(0, 2 * np.pi / mean_motion, points))
    return np.einsum("kij,nj->nki", A[:, :3], states)
