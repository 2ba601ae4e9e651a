"""Worlds in which a plan is flown."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.orbit.dynamics import Dynamics


@runtime_checkable
class World(Protocol):
    """How craft really move, each on its own.

    States are x y z vx vy vz in the LVLH frame of the reference orbit, m and m/s; controls are
    accelerations along its axes, m/s², held constant there.
    """

    def arc(
        self,
        states: Float[Array, "N 6"],
        controls: Float[Array, "N 3"],
        start: float,
        duration: float,
        pieces: int,
    ) -> Float[Array, "N _ 6"]:
        """States at ``pieces`` + 1 equally spaced times of one arc, both ends included.

        Args:
            states: at its start.
            controls: held over all of it.
            start: of the arc, s since the plan's first node.
            duration: of the arc, s.
            pieces: into which it is cut.
        """
        ...


@dataclass(frozen=True)
class LinearWorld:
    """The world that plans are made for.

    Attributes:
        dynamics: of the scenario's problem.
    """

    dynamics: Dynamics

    def arc(
        self,
        states: Float[Array, "N 6"],
        controls: Float[Array, "N 3"],
        start: float,
        duration: float,
        pieces: int,
    ) -> Float[Array, "N _ 6"]:
        """As ``World.arc``, in closed form; when the arc starts makes no difference."""
        A, B = self.dynamics.step(np.linspace(0.0, duration, pieces + 1))
        flown: Float[Array, "N _ 6"] = np.matvec(A, states[:, None])
        flown += np.matvec(B, controls[:, None])
        return flown
