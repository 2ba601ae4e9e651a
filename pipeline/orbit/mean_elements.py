"""Mean elements: osculating elements without their short-period variations by J2, to first order.

Mean elements are represented by the state that has them as osculating elements. By the method of
averaging, Gauss's equations along the mean orbit, less their average, are integrated such that the
integral averages to zero over a revolution (short-period terms: Brouwer 1959, "Solution of the
problem of artificial satellite theory without drag"; Gauss's equations: Battin, "An Introduction to
the Mathematics and Methods of Astrodynamics", section 10.3). Semi-major axis, vector of
eccentricity, mean longitude and direction of the orbital plane, all relative to the LVLH axes, are
regular also for circular and equatorial orbits.
"""

from dataclasses import dataclass, replace

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.orbit.arrays import Formation, PerCraft, Rows, norm
from pipeline.orbit.forces import oblateness
from pipeline.orbit.inertial import lvlh_axes
from pipeline.orbit.reference import J2, MU_EARTH, R_EARTH

SAMPLES = 128  # of a revolution, equally spaced in eccentric longitude
CLOSE = 3e-14  # residual at which iteration ends, in radii of the orbit
ITERATIONS = 30


@dataclass(frozen=True, eq=False)
class PlanarElements(Rows):
    """Nonsingular elements of orbits; longitudes count from the first axis of their planes."""

    axes: Float[Array, "n 3 3"]  # two in the orbital plane, and its normal, as columns
    semi_major_axis: PerCraft  # m
    eccentricity: Float[Array, "n 2"]  # vector towards the perigee, along the first two axes
    longitude: PerCraft  # mean longitude: of the perigee, plus mean anomaly, rad

    @classmethod
    def of(cls, states: Formation) -> "PlanarElements":
        """Elements of inertial states, m and m/s, in their LVLH axes."""
        position, velocity = states[..., :3], states[..., 3:]
        r, h = norm(position), norm(np.cross(position, velocity))
        rising = np.vecdot(position, velocity) / r
        x, y = h**2 / (MU_EARTH * r) - 1, -rising * h / MU_EARTH
        root = np.sqrt(1 - x**2 - y**2)
        a = h**2 / (MU_EARTH * root**2)
        share, beta = r / (a * root), 1 / (1 + root)
        cos, sin = x + share * (1 - beta * x**2), y - share * beta * x * y
        longitude = np.arctan2(sin, cos) - x * sin + y * cos
        return cls(lvlh_axes(states), a, np.stack([x, y], axis=-1), longitude)

    @property
    def mean_motion(self) -> PerCraft:
        """Mean motion, rad/s."""
        return np.sqrt(MU_EARTH / self.semi_major_axis**3)

    @property
    def eccentricity_squared(self) -> PerCraft:
        """Square of the eccentricity."""
        return np.vecdot(self.eccentricity, self.eccentricity)

    def eccentric_longitude(self) -> PerCraft:
        """Longitude of the perigee plus eccentric anomaly, rad, by Kepler's equation."""
        x, y = np.moveaxis(self.eccentricity, -1, 0)
        found = self.longitude + x * np.sin(self.longitude) - y * np.cos(self.longitude)
        for _ in range(ITERATIONS):
            cos, sin, before = np.cos(found), np.sin(found), found
            found = found - (found - x * sin + y * cos - self.longitude) / (1 - x * cos - y * sin)
            if (found == before).all():
                break
        return found

    def states(self) -> Formation:
        """Inertial states, m and m/s."""
        return self.states_at(self.eccentric_longitude()[..., None])[..., 0, :]

    def states_at(self, eccentric: Float[Array, "n q"]) -> Float[Array, "n q 6"]:
        """Inertial states, m and m/s, at eccentric longitudes, rad."""
        x, y = np.moveaxis(self.eccentricity[..., None, :], -1, 0)
        a, n = self.semi_major_axis[..., None], self.mean_motion[..., None]
        beta = 1 / (1 + np.sqrt(1 - x**2 - y**2))
        one, other, both = 1 - beta * y**2, 1 - beta * x**2, beta * x * y
        cos, sin = np.cos(eccentric), np.sin(eccentric)
        speed = n * a / (1 - x * cos - y * sin)
        position = [a * (one * cos + both * sin - x), a * (other * sin + both * cos - y)]
        velocity = [speed * (both * cos - one * sin), speed * (other * cos - both * sin)]
        turn = self.axes[..., None, :, :2]
        parts = [np.matvec(turn, np.stack(pair, axis=-1)) for pair in (position, velocity)]
        return np.concatenate(parts, axis=-1)

    def changed(self, by: Float[Array, "n 6"]) -> "PlanarElements":
        """Elements with changes of semi-major axis, eccentricity, longitude and plane added."""
        angle = np.concatenate([by[..., 4:], np.zeros_like(by[..., :1])], axis=-1)
        return PlanarElements(
            self.axes @ rotation(angle),
            self.semi_major_axis + by[..., 0],
            self.eccentricity + by[..., 1:3],
            self.longitude + by[..., 3],
        )


def rotation(angle: Float[Array, "n 3"]) -> Float[Array, "n 3 3"]:
    """The rotation matrix of a rotation vector, rad, by Rodrigues' formula."""
    size = norm(angle)[..., None, None]
    columns = np.cross(angle[..., None, :], np.eye(3)).mT
    # sin θ/θ and (1 - cos θ)/θ², regular at 0
    first, second = np.sinc(size / np.pi), np.sinc(size / (2 * np.pi)) ** 2 / 2
    return np.asarray(np.eye(3) + first * columns + second * columns @ columns)


def osculating_states(mean: Formation, *, j2: bool = True) -> Formation:
    """Inertial states, m and m/s, with the mean elements that ``mean`` states represent.

    Without J2 both are the same.
    """
    # Semi-major axes, and so along-track drifts, are corrected to second order, but for a constant,
    # by the energy, which is a constant of the motion.
    if not j2:
        return mean
    elements = PlanarElements.of(mean)
    found = elements.changed(_periodic(elements))
    for _ in range(2):
        missing = _mean_energy(elements) - _energy(found.states())
        a = found.semi_major_axis
        found = replace(found, semi_major_axis=a + 2 * a**2 / MU_EARTH * missing)
    return found.states()


def _energy(states: Formation) -> PerCraft:
    """Specific energy of inertial states, m²/s², in the potential of a point and J2."""
    r, v = norm(states[:, :3]), states[:, 3:]
    oblate = 0.5 * J2 * MU_EARTH * R_EARTH**2 / r**3 * (3 * (states[:, 2] / r) ** 2 - 1)
    return np.vecdot(v, v) / 2 - MU_EARTH / r + oblate


def _mean_energy(mean: PlanarElements) -> PerCraft:
    """Specific energy of mean elements, m²/s²: the potential averaged over a revolution."""
    a, cos = mean.semi_major_axis, mean.axes[:, 2, 2]
    cubed = (a**2 * (1 - mean.eccentricity_squared)) ** 1.5
    oblate = 0.25 * J2 * MU_EARTH * R_EARTH**2 / cubed * (1 - 3 * cos**2)
    return -MU_EARTH / (2 * a) + oblate


def mean_states(osculating: Formation, *, j2: bool = True) -> Formation:
    """The inverse of ``osculating_states``, by fixed-point iteration."""
    if not j2:
        return osculating
    found, far = osculating, norm(osculating[..., :3])
    for _ in range(ITERATIONS):
        missed = osculating - osculating_states(found)
        found = found + missed
        if (norm(missed[..., :3]) <= CLOSE * far).all():
            break
    return found


def _periodic(elements: PlanarElements) -> Float[Array, "n 6"]:
    """Short-period variations by J2, as changes of ``PlanarElements.changed``."""
    start = elements.eccentric_longitude()[..., None]
    states = elements.states_at(start + 2 * np.pi / SAMPLES * np.arange(SAMPLES))
    rates = _rates(elements, states)
    share = norm(states[..., :3])[..., None] / elements.semi_major_axis[..., None, None]
    n = elements.mean_motion[..., None, None]
    change = _integral(rates, share, n)
    slower = -1.5 * n[..., 0] / elements.semi_major_axis[..., None] * change[..., 0]
    change[..., 3] += _integral(slower[..., None], share, n)[..., 0]
    return change[..., 0, :]


def _integral(
    rates: Float[Array, "n q c"], share: Float[Array, "n q 1"], n: Float[Array, "n 1 1"]
) -> Float[Array, "n q c"]:
    """Zero-average time integral of rates less their average; shares are r/a."""

    def average(values: Float[Array, "n q c"]) -> Float[Array, "n 1 c"]:
        return (values * share).mean(axis=-2, keepdims=True)

    waves = np.fft.rfft((rates - average(rates)) * share / n, axis=-2)
    order = np.arange(SAMPLES // 2 + 1)[:, None]
    order[[0, -1]] = 1
    waves[..., [0, -1], :] = 0.0  # the constant, and the frequency that the samples do not resolve
    found = np.fft.irfft(waves / (1j * order), n=SAMPLES, axis=-2)
    return np.asarray(found - average(found))


def _rates(elements: PlanarElements, states: Float[Array, "n q 6"]) -> Float[Array, "n q 6"]:
    """Gauss's equations for J2: rates of the changes that ``PlanarElements.changed`` takes."""
    position, axes = states[..., :3], lvlh_axes(states)
    radial, along, across = np.moveaxis(np.matvec(axes.mT, oblateness(position)), -1, 0)
    plane = elements.axes[..., None, :, :2]
    cos, sin = np.moveaxis(np.matvec(plane.mT, axes[..., 0]), -1, 0)
    x, y = np.moveaxis(elements.eccentricity[..., None, :], -1, 0)
    a, r = elements.semi_major_axis[..., None], norm(position)
    root = np.sqrt(1 - x**2 - y**2)
    p = a * root**2
    h = np.sqrt(MU_EARTH * p)
    towards, beside = x * cos + y * sin, x * sin - y * cos  # e cos ν and e sin ν
    beta = 1 / (1 + root)
    rates = [
        2 * a**2 / h * (beside * radial + p / r * along),
        (p * sin * radial + ((p + r) * cos + r * x) * along) / h,
        (-p * cos * radial + ((p + r) * sin + r * y) * along) / h,
        (-(beta * p * towards + 2 * root * r) * radial + beta * (p + r) * beside * along) / h,
        r * cos * across / h,
        r * sin * across / h,
    ]
    return np.stack(rates, axis=-1)


def secular_rates(mean: PlanarElements, *, j2: bool = True) -> tuple[PerCraft, PerCraft, PerCraft]:
    """Rates of perigee ω, mean anomaly M and node Ω, rad/s, to first order in J2.

    Vallado, "Fundamentals of Astrodynamics and Applications", section 9.6.
    """
    n, square = mean.mean_motion, 1 - mean.eccentricity_squared
    cos = mean.axes[..., 2, 2]  # of the inclination
    pull = 1.5 * J2 * n * (R_EARTH / (mean.semi_major_axis * square)) ** 2 * j2
    anomaly = n + pull * np.sqrt(square) * (1.5 * cos**2 - 0.5)
    return pull * (2.5 * cos**2 - 0.5), anomaly, -pull * cos
