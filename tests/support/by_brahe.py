"""Chief and deputy as the propagator of brahe flies them."""

from functools import partial

import brahe
import numpy as np

from pipeline.orbit.forces import Atmosphere
from pipeline.orbit.reference import J2, MU_EARTH, R_EARTH


def acceleration_by_brahe(
    state: np.ndarray, j2: bool, air: Atmosphere | None, ballistic: float
) -> np.ndarray:
    """Of the forces of brahe, whose constants of gravity are a little different."""
    total = brahe.accel_point_mass_gravity(state[:3], np.zeros(3), MU_EARTH)
    if j2:
        zonal = brahe.accel_earth_zonal_gravity(state[:3], 2)
        zonal = zonal - brahe.accel_point_mass_gravity(state[:3], np.zeros(3), brahe.GM_EARTH)
        ours = J2 * MU_EARTH * R_EARTH**2
        total = total + zonal * ours / (brahe.J2_EARTH * brahe.GM_EARTH * brahe.R_EARTH**2)
    if air is not None:
        height = np.linalg.norm(state[:3]) - R_EARTH
        density = air.density * np.exp(-(height - air.base) / air.scale)
        total = total + brahe.accel_drag(state, density, 1.0, ballistic, 1.0, np.eye(3))
    return total


def flown_by_brahe(
    start: np.ndarray,
    pushes: np.ndarray,
    forces: tuple[bool, Atmosphere | None],
    ballistics: tuple[float, float],
    step: float,
) -> np.ndarray:
    """Chief and deputy after all arcs, integrated together by brahe's RKF78; inertial.

    Forces are J2 and the air; the deputy is pushed, m/s², along the chief's LVLH axes.
    """

    def motion(_: float, both: np.ndarray, push: np.ndarray) -> np.ndarray:
        chief, deputy = both[:6], both[6:]
        thrust = brahe.rotation_rtn_to_eci(chief) @ push
        a, b = (
            acceleration_by_brahe(one, *forces, held)
            for one, held in zip((chief, deputy), ballistics, strict=True)
        )
        return np.concatenate([chief[3:], a, deputy[3:], b + thrust])

    config = brahe.IntegratorConfig.adaptive(abs_tol=1e-9, rel_tol=1e-14)
    both = start
    for push in pushes:
        integrator = brahe.RKF78Integrator(12, partial(motion, push=push), config=config)
        done = 0.0
        while done < step:
            result = integrator.step(done, both, min(10.0, step - done))
            both, done = result.state, done + result.dt_used
    return both
