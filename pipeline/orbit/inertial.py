"""Between the LVLH frame of a reference orbit and an inertial one, exactly, whatever the orbit."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array


@dataclass(frozen=True, eq=False)
class Frame:
    """LVLH frames of an orbit at some times.

    Attributes:
        axes: the radial, along-track and cross-track unit vectors as columns, (*batch, 3, 3).
        rate: angular velocity of the frame along these axes, (*batch, 3), rad/s.
    """

    axes: Float[Array, "*batch 3 3"]
    rate: Float[Array, "*batch 3"]

    def to_inertial(self, states: Float[Array, "*many 6"]) -> Float[Array, "*more 6"]:
        """Inertial position and velocity less those of the frame's origin, m and m/s."""
        position, velocity = states[..., :3], states[..., 3:]
        moving = velocity + np.cross(self.rate, position)
        return np.concatenate(
            [np.matvec(self.axes, position), np.matvec(self.axes, moving)], axis=-1
        )

    def from_inertial(self, apart: Float[Array, "*many 6"]) -> Float[Array, "*more 6"]:
        """The inverse of ``to_inertial``: x y z vx vy vz as the turning frame has them."""
        turned = self.axes.swapaxes(-1, -2)
        position, moving = np.matvec(turned, apart[..., :3]), np.matvec(turned, apart[..., 3:])
        return np.concatenate([position, moving - np.cross(self.rate, position)], axis=-1)


def lvlh_axes(origin: Float[Array, "*batch 6"]) -> Float[Array, "*batch 3 3"]:
    """The axes of ``Frame``: along r, h × r and h = r × v of the origin's inertial state."""
    position, velocity = origin[..., :3], origin[..., 3:]
    momentum = np.cross(position, velocity)
    radial = position / _length(position)
    cross = momentum / _length(momentum)
    return np.stack([radial, np.cross(cross, radial), cross], axis=-1)


def lvlh_frame(origin: Float[Array, "*batch 6"], acceleration: Float[Array, "*batch 3"]) -> Frame:
    """The LVLH frames of an orbit.

    The frame turns about its cross-track axis at h/r², and where the orbital plane itself is
    turned, by an acceleration aₙ across it, about its radial axis at r aₙ/h (Alfriend and others,
    "Spacecraft Formation Flying", section 4.1).

    Args:
        origin: inertial states, m and m/s.
        acceleration: of the origin, m/s²; what of it is in the orbital plane makes no difference.
    """
    axes = lvlh_axes(origin)
    position, velocity = origin[..., :3], origin[..., 3:]
    r, h = _length(position)[..., 0], _length(np.cross(position, velocity))[..., 0]
    across = np.vecdot(axes[..., 2], acceleration)
    return Frame(axes, np.stack([r * across / h, np.zeros_like(r), h / r**2], axis=-1))


def _length(vectors: Float[Array, "*batch 3"]) -> Float[Array, "*batch 1"]:
    return np.sqrt(np.vecdot(vectors, vectors))[..., None]
