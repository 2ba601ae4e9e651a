"""Relative motion, linear and in all terms, by other roads than the product's.

Linear about a Keplerian orbit in closed form (Yamanaka and Ankersen 2002, "New state transition
matrix for relative motion on an arbitrary elliptical orbit"); about any orbit by an integrator,
from forces whose derivatives are complex steps. Axes are LVLH (x radial, y along-track, z
cross-track).
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

MU = 398600.4418e9
"""Of the Earth, m³/s²; as all constants here, those of EGM96 and WGS84."""

RADIUS = 6378137.0
"""Of the Earth at the equator, m."""

J2 = 1.0826266836e-3

TURN = 7.292115e-5
"""Of the Earth, rad/s."""

STEP = 1e-30
"""Of complex derivatives, as a share."""

Times = float | np.ndarray
"""Numbers, or arrays of them."""

Air = tuple[float, float, float]
"""Height of a known density, m, that density, kg/m³, and the height in which it falls to 1/e, m."""


def true_anomaly(a: float, e: float, begin: Times, time: Times) -> Any:
    """True anomaly some s after another, rad, by Kepler's equation; whole revolutions counted."""
    half = np.sqrt((1 - e) / (1 + e))
    tangent = np.tan(begin / 2)
    first = begin + 2 * np.arctan2((half - 1) * tangent, 1 + half * tangent**2)
    mean = first - e * np.sin(first) + np.sqrt(MU / a**3) * time
    eccentric = mean
    for _ in range(100):
        left = eccentric - e * np.sin(eccentric) - mean
        eccentric = eccentric - left / (1 - e * np.cos(eccentric))
        if np.all(np.abs(left) < 1e-15 * np.maximum(1.0, np.abs(mean))):
            break
    tangent = np.tan(eccentric / 2)
    return eccentric + 2 * np.arctan2((1 / half - 1) * tangent, 1 + tangent**2 / half)


def yamanaka_ankersen(a: float, e: float, begin: Times, time: Times) -> np.ndarray:
    """State-transition matrices (..., 6, 6) by initial true anomaly, rad, and time since, s."""
    end = true_anomaly(a, e, begin, time)
    momentum = np.sqrt(MU * a * (1 - e**2))
    k2 = momentum / (a * (1 - e**2)) ** 2
    in_plane = _fundamental(e, end, k2 * time) @ np.linalg.inv(_fundamental(e, begin, 0 * time))
    turn = end - begin
    tilde = np.zeros((*np.shape(turn), 6, 6))
    plane, across = [0, 2, 3, 5], [1, 4]  # x, z and their derivatives; y and its own
    tilde[..., np.array(plane)[:, None], plane] = in_plane
    cross = _matrices([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    tilde[..., np.array(across)[:, None], across] = cross
    theirs = np.linalg.inv(_tilde(e, end, k2)) @ tilde @ _tilde(e, begin, k2)
    axes = np.zeros((6, 6))  # x along the velocity, y against the momentum, z towards the Earth
    axes[[0, 1, 2, 3, 4, 5], [1, 2, 0, 4, 5, 3]] = [1, -1, -1, 1, -1, -1]
    return axes.T @ theirs @ axes


def _matrices(rows: list[list[Any]]) -> np.ndarray:
    """Matrices (..., rows, columns) from lists of their entries, numbers or arrays (...)."""
    entries = np.broadcast_arrays(*(one for row in rows for one in row))
    return np.stack(entries, axis=-1).reshape(*entries[0].shape, len(rows), len(rows[0]))


def _fundamental(e: float, anomaly: Times, j: Times) -> np.ndarray:
    """Four solutions of the in-plane motion as columns; rows x̃, z̃ and their derivatives."""
    sin, cos = np.sin(anomaly), np.cos(anomaly)
    rho = 1 + e * cos
    s, c = rho * sin, rho * cos
    ds, dc = cos + e * np.cos(2 * anomaly), -(sin + e * np.sin(2 * anomaly))
    return _matrices(
        [
            [1, -c * (1 + 1 / rho), s * (1 + 1 / rho), 3 * rho**2 * j],
            [0, s, c, 2 - 3 * e * s * j],
            [0, 2 * s, 2 * c - e, 3 * (1 - 2 * e * s * j)],
            [0, ds, dc, -3 * e * (ds * j + s / rho**2)],
        ]
    )


def _tilde(e: float, anomaly: Times, k2: float) -> np.ndarray:
    """From positions and velocities to those scaled by ρ, per radian of true anomaly."""
    rho = 1 + e * np.cos(anomaly)
    scaled = _matrices([[rho, 0.0], [-e * np.sin(anomaly), 1 / (k2 * rho)]])
    return np.kron(scaled, np.eye(3))


def forced(a: float, e: float, begin: float, time: float) -> np.ndarray:
    """What a held acceleration comes to over some s, (6, 3): ∫ Φ(T, t) (0, I) dt by quadrature."""
    at, weight = np.polynomial.legendre.leggauss(20)
    parts = max(1, int(np.ceil(10 * time * np.sqrt(MU / a**3))))
    middles = (np.arange(parts) + 0.5) / parts
    shares = (middles[:, None] + at / 2 / parts).ravel()
    later = true_anomaly(a, e, begin, shares * time)
    columns = yamanaka_ankersen(a, e, later, (1 - shares) * time)[..., 3:]
    return time / 2 / parts * np.tensordot(np.tile(weight, parts), columns, axes=1)


def pull(
    state: np.ndarray, j2: bool, ballistic: float | np.ndarray = 0.0, air: Air | None = None
) -> np.ndarray:
    """Acceleration at inertial states (..., 6), which may be complex, m/s²."""
    r = _components(state[..., :3])
    far = _length(r)
    total = -MU / (far * far * far) * r
    if j2:  # the gradient of -(μ J2 R²/2) (3 z²/r² - 1)/r³
        share = (r[2] / far) ** 2
        size = 1.5 * MU * J2 * RADIUS**2 / (far * far) ** 2 / far
        total += (size * (5 * share - 1)) * r
        total[2] -= 2 * size * r[2]
    if air is not None:
        base, density, scale = air
        vx, vy, vz = _components(state[..., 3:])
        wind = np.stack([vx + TURN * r[1], vy - TURN * r[0], vz])
        thick = density * np.exp(-(far - RADIUS - base) / scale)
        total = total - thick * ballistic / 2 * _length(wind) * wind
    return total.transpose(*range(1, total.ndim), 0)


def _components(v: np.ndarray) -> np.ndarray:
    """The last axis first, faster than ``np.moveaxis``."""
    return v.transpose(-1, *range(v.ndim - 1))


def _length(v: np.ndarray) -> np.ndarray:
    return np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)


def axes(state: np.ndarray) -> np.ndarray:
    """LVLH unit vectors of inertial states (..., 6), which may be complex, as columns."""
    r, v = _components(state[..., :3]), _components(state[..., 3:])
    h = _cross(r, v)
    radial, cross = r / _length(r), h / _length(h)
    columns = np.stack([radial, _cross(cross, radial), cross])
    return columns.transpose(*range(2, columns.ndim), 1, 0)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products a × b of vectors (3, ...), whose first axis holds the components."""
    (ax, ay, az), (bx, by, bz) = a, b
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def to_lvlh(state: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """From inertial differences to LVLH ones (..., 6, 6), about a reference's inertial states."""
    turning = np.concatenate([state[..., 3:], acceleration], axis=-1)
    both = axes(state + 1j * STEP * turning).swapaxes(-1, -2)
    turned, rate = both.real, both.imag / STEP
    upper = np.concatenate([turned, 0 * turned], axis=-1)
    return np.concatenate([upper, np.concatenate([rate, turned], axis=-1)], axis=-2)


LONGEST = 600.0
"""Of a piece of an orbit, s; pieces are integrated side by side."""

Force = Callable[[np.ndarray], np.ndarray]
"""The acceleration at inertial states, which may be complex."""


def linear_maps(
    begin: np.ndarray, times: np.ndarray, force: Force
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (k, 6, 6) and B (k, 6, 3) to ascending times, s, and a reference's inertial states there.

    From its state at the beginning. Controls are held along the LVLH axes, which turn.
    """
    counts = np.ceil(np.diff(times, prepend=0.0) / LONGEST).clip(1).astype(int)
    ends = np.interp(np.arange(1, counts.sum() + 1), [0, *counts.cumsum()], [0.0, *times])
    states = _reference(begin, ends, force)
    pieces = _between(states[:-1], np.diff(ends, prepend=0.0), force)
    free, forced, found = np.eye(6), np.zeros((6, 3)), []
    for A, B in zip(*pieces, strict=True):
        free, forced = A @ free, A @ forced + B
        found.append(np.hstack([free, forced]))
    at, both = counts.cumsum() - 1, np.array(found)
    return both[at, :, :6], both[at, :, 6:], states[at + 1]


def _reference(begin: np.ndarray, ends: np.ndarray, force: Force) -> np.ndarray:
    """Inertial states (k + 1, 6) of the reference orbit at time 0 and at k ascending times, s."""

    def motion(_: float, state: np.ndarray) -> np.ndarray:
        return np.concatenate([state[3:], force(state)])

    solved = solve_ivp(
        motion, (0.0, ends[-1]), begin, method="DOP853", t_eval=ends, rtol=2.3e-14, atol=1e-12
    )
    return np.vstack([begin, solved.y.T])


def _between(
    begins: np.ndarray, lengths: np.ndarray, force: Force
) -> tuple[np.ndarray, np.ndarray]:
    """State-transition matrices (k, 6, 6) and control matrices (k, 6, 3) of k arcs of an orbit.

    From the inertial states (k, 6) where the arcs begin, and how long each takes, s.
    """
    scale = np.array([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])[:, None]  # 1 m and 1 mm/s alike
    k, steps = len(begins), np.eye(7, 6)  # the last is where the reference is itself

    def motion(_: float, flat: np.ndarray) -> np.ndarray:
        states, maps = flat[: 6 * k].reshape(k, 6), flat[6 * k :].reshape(k, 6, 9) * scale
        pulled = force(states[:, None] + 1j * STEP * steps)
        gradient = pulled[:, :6].imag.swapaxes(1, 2) / STEP
        rates = np.concatenate([maps[:, 3:], gradient @ maps], axis=1)
        rates[:, 3:, 6:] += axes(states)
        moved = np.concatenate([states[:, 3:], pulled[:, 6].real], axis=1)
        rates = rates / scale * lengths[:, None, None]
        return np.concatenate([(moved * lengths[:, None]).ravel(), rates.ravel()])

    first = np.linalg.inv(to_lvlh(begins, force(begins)))
    start = np.concatenate([first, np.zeros((k, 6, 3))], axis=2) / scale
    flat = np.concatenate([begins.ravel(), start.ravel()])
    solved = solve_ivp(  # short arcs need one step alone
        motion, (0.0, 1.0), flat, method="DOP853", first_step=1.0, rtol=1e-13, atol=1e-12
    )
    end = solved.y[:, -1]
    states, maps = end[: 6 * k].reshape(k, 6), end[6 * k :].reshape(k, 6, 9) * scale
    seen = to_lvlh(states, force(states)) @ maps
    return seen[..., :6], seen[..., 6:]


def linear_flight(
    begin: np.ndarray, step: float, intervals: int, parts: int, force: Force
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """What flies craft about a reference: states (..., 6) and controls (..., intervals, 3).

    Its result is their states at equal parts of all intervals, (..., intervals, parts + 1, 6).
    """
    ends = step * np.arange(1, intervals * parts + 1) / parts
    states = _reference(begin, ends, force)
    A, B = _between(states[:-1], np.full(len(ends), step / parts), force)
    maps = np.concatenate([A, B], axis=-1).reshape(intervals, parts, 6, 9)
    for part in range(1, parts):  # from where the interval begins
        further = maps[:, part, :, :6] @ maps[:, part - 1]
        further[..., 6:] += maps[:, part, :, 6:]
        maps[:, part] = further

    def fly(states: np.ndarray, controls: np.ndarray) -> np.ndarray:
        flown = []
        for k in range(intervals):
            both = np.concatenate([states, controls[..., k, :]], axis=-1)
            later = (both @ maps[k].reshape(-1, 9).T).reshape(*states.shape[:-1], parts, 6)
            flown.append(np.concatenate([states[..., None, :], later], axis=-2))
            states = later[..., -1, :]
        return np.stack(flown, axis=-3)

    return fly


def flight(
    begin: np.ndarray,
    states: np.ndarray,
    controls: np.ndarray,
    grid: tuple[float, int],
    force: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Craft and their reference integrated together: LVLH states (n, intervals, parts + 1, 6).

    At equal parts of all intervals, from the reference's inertial state and LVLH states (n, 6), by
    controls (n, intervals, 3). The grid is the length of an interval, s, and the parts. ``force``
    is the acceleration at the inertial states of the reference and the craft, (n + 1, 6).
    """
    (step, parts), origin, n = grid, begin, len(states)

    def pulls(origin: np.ndarray, apart: np.ndarray) -> np.ndarray:
        return force(np.concatenate([origin, origin + apart], axis=-2))

    def motion(_: float, flat: np.ndarray, push: np.ndarray) -> np.ndarray:
        origin, apart = flat[:6], flat[6:].reshape(n, 6)
        pulled = pulls(origin[None], apart)
        moved = np.hstack([apart[:, 3:], pulled[1:] - pulled[0] + push @ axes(origin).T])
        return np.concatenate([origin[3:], pulled[0], moved.ravel()])

    begins = to_lvlh(origin, pulls(origin[None], 0 * states)[0])
    apart, flown = np.linalg.solve(begins, states.T).T, []
    times = np.linspace(0.0, step, parts + 1)
    for k in range(controls.shape[1]):
        start = np.concatenate([origin, apart.ravel()])
        pushed = partial(motion, push=controls[:, k])
        limits: dict[str, Any] = {"rtol": 2.3e-14, "atol": 1e-10, "first_step": step / 2}
        solved = solve_ivp(pushed, (0.0, step), start, method="DOP853", t_eval=times, **limits)
        origins, aparts = solved.y[:6].T, solved.y[6:].T.reshape(-1, n, 6)
        seen = to_lvlh(origins, pulls(origins[:, None], aparts)[:, 0])
        flown.append(aparts @ seen.swapaxes(1, 2))
        origin, apart = origins[-1], aparts[-1]
    return np.array(flown).transpose(2, 0, 1, 3)


def state_of(a: float, e: float, angles: np.ndarray) -> np.ndarray:
    """Inertial state of osculating elements; inclination, node, perigee, argument of latitude."""
    inclination, node, perigee, latitude = angles
    anomaly, p = latitude - perigee, a * (1 - e**2)
    far = p / (1 + e * np.cos(anomaly))
    plane = far * np.array([np.cos(anomaly), np.sin(anomaly), 0.0])
    speed = np.sqrt(MU / p) * np.array([-np.sin(anomaly), e + np.cos(anomaly), 0.0])
    c, s = np.cos(inclination), np.sin(inclination)
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    turn = _about_z(node) @ tilt @ _about_z(perigee)
    return np.concatenate([turn @ plane, turn @ speed])


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def file_flown(plan: dict[str, Any], parts: int, air: Air | None = None) -> np.ndarray:
    """The flight of a plan file's fields in its world, as ``flight`` has it."""
    world, asked = plan["world"], plan["scenario"]
    names = ("inclination", "raan", "argument_of_perigee", "argument_of_latitude")
    angles = np.deg2rad([world[f"{name}_deg"] for name in names])
    begin = state_of(world["semi_major_axis"], world["eccentricity"], angles)
    shares = np.concatenate([[0.0], np.linspace(-1, 1, len(asked["initial"]))])
    held = (world["ballistic"] or 0.0) * (1 + world["spread"] * shares)
    force = partial(pull, j2=world["j2"], ballistic=held, air=air)
    states, controls = (np.array(one) for one in (asked["initial"], plan["controls"]))
    return flight(begin, states, controls, (asked["time_step"], parts), force)
