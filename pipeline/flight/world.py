"""Worlds in which a plan is flown: the linear model, and two bodies with J2 and drag."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

from pipeline.arrays import Array
from pipeline.errors import InputError, ProlearnError
from pipeline.orbit.dynamics import Dynamics
from pipeline.orbit.forces import Atmosphere, drag, oblateness, point_mass
from pipeline.orbit.inertial import Elements, lvlh_axes, lvlh_frame

TOLERANCE = 1e-6
"""Of a step of the integrator for each craft, m; of velocities, in m/s, this times TURN."""

# About the mean motion of a low orbit, 1/s: an error in velocity counts like one in position
TURN = 1e-3
RELATIVE = 2.3e-14  # tolerance: the least that scipy accepts; it matters to the reference alone

States = Float[Array, "N 6"]
Held = Float[Array, "N 3"]  # controls
Arcs = Float[Array, "N _ 6"]


@runtime_checkable
class World(Protocol):
    """How craft really move, each on its own.

    States are x y z vx vy vz in the LVLH frame of the reference orbit, m and m/s; controls are
    accelerations along its axes, m/s², held constant there.
    """

    def arc(
        self, states: States, controls: Held, start: float, duration: float, pieces: int
    ) -> Arcs:
        """States at ``pieces`` + 1 equally spaced times of one arc, both ends included.

        From states at its start, by controls held over all of it; it begins at ``start``, s since
        the plan's first node, and takes ``duration``, s.
        """


@dataclass(frozen=True)
class LinearWorld:
    """The linear model for which plans are made, in closed form; a ``World``."""

    dynamics: Dynamics

    def arc(
        self, states: States, controls: Held, start: float, duration: float, pieces: int
    ) -> Arcs:
        """As ``World.arc``; when the arc starts makes no difference."""
        A, B = self.dynamics.step(np.linspace(0.0, duration, pieces + 1))
        return np.matvec(A, states[:, None]) + np.matvec(B, controls[:, None])


@dataclass(frozen=True)
class Drag:
    """Air, and the ballistic coefficients C_D A/m of what it acts on, m²/kg.

    Those of craft are for each trial again, where states are of trials one after the other.
    """

    air: Atmosphere
    ballistic: tuple[float, ...]  # of each craft
    reference: float = 0.0  # of the virtual craft that the LVLH frame is about

    def coefficients(self, count: int) -> Float[Array, "_"]:
        """Those of the reference and then ``count`` craft; InputError for a part of a trial."""
        n = len(self.ballistic)
        if count % n:
            raise InputError(f"{count} states are flown; expected a multiple of {n} craft.")
        return np.concatenate([[self.reference], np.tile(self.ballistic, count // n)])


@dataclass(frozen=True)
class NonlinearWorld:
    """Craft about an oblate Earth, each integrated in an inertial frame; a ``World``.

    The LVLH frame is about a virtual craft that never burns. It is subject to the same forces as
    all others, and to drag with a coefficient of its own; with the swarm's mean coefficient, the
    frame decays with the swarm, and what is left is differential drag. Thrust is constant along the
    axes of that frame, which turns meanwhile.

    All craft and the reference are one system of equations, for the latter's state and the
    others' differences from it, which keeps digits. Steps are those of DOP853, an error-controlled
    Runge-Kutta method of order 8. Its norm is a root mean square over all craft, so tolerances are
    divided by the root of their number: then each is at least as good as on its own. Other craft
    in the same arc change a result by less than the tolerance, and are not without effect.
    """

    elements: Elements  # osculating, of the reference at the plan's first node
    argument_of_latitude: float = 0.0  # of the reference there, rad
    j2: bool = True  # whether the Earth is oblate
    drag: Drag | None = None  # or None
    tolerance: float = TOLERANCE  # of a step, m

    def arc(
        self, states: States, controls: Held, start: float, duration: float, pieces: int
    ) -> Arcs:
        """As ``World.arc``; ProlearnError where the integrator fails, since a state is NaN."""
        if duration == 0:
            return np.repeat(states[:, None], pieces + 1, axis=1)
        origin = self.reference(start)
        apart = lvlh_frame(origin, self._accelerations(origin[None])[0]).to_inertial(states)
        flown = self._integrate(np.concatenate([origin[None], apart]), controls, duration, pieces)
        origins = flown[:, 0]
        frame = lvlh_frame(origins, self._accelerations(origins))
        return frame.from_inertial(flown[:, 1:].swapaxes(0, 1))

    def reference(self, time: float) -> Float[Array, "6"]:
        """Inertial state of the reference so long after the plan's first node, m and m/s."""
        return _reference(self, time)

    def _integrate(
        self, begin: Float[Array, "_ 6"], controls: Held, duration: float, pieces: int
    ) -> Float[Array, "_ _ 6"]:
        """The reference's state and the others' differences from it, by time and craft."""
        count = len(begin)
        ballistic = None if self.drag is None else self.drag.coefficients(count - 1)

        def motion(_: float, flat: Float[Array, "_"]) -> Float[Array, "_"]:
            now = flat.reshape(count, 6)
            absolute = now.copy()
            absolute[1:] += now[0]
            accelerations = self._accelerations(absolute, ballistic)
            accelerations[1:] -= accelerations[0]
            accelerations[1:] += controls @ lvlh_axes(now[0]).T
            return np.concatenate([now[:, 3:], accelerations], axis=1).ravel()

        each = np.repeat([1.0, TURN], 3) * self.tolerance / np.sqrt(count)
        solved = solve_ivp(
            motion,
            (0.0, duration),
            begin.ravel(),
            method="DOP853",
            t_eval=np.linspace(0.0, duration, pieces + 1),
            rtol=RELATIVE,
            atol=np.tile(each, count),
        )
        if not solved.success:
            raise ProlearnError(f"an arc of {duration:g} s could not be flown: {solved.message}")
        return solved.y.T.reshape(pieces + 1, count, 6)

    def _accelerations(
        self, states: Float[Array, "N 6"], ballistic: Float[Array, "N"] | None = None
    ) -> Float[Array, "N 3"]:
        """By all forces but thrust at inertial states, m/s²; by default on the reference."""
        position = states[:, :3]
        total = point_mass(position)
        if self.j2:
            total += oblateness(position)
        if self.drag is not None:
            held = np.full(len(states), self.drag.reference) if ballistic is None else ballistic
            total += drag(states, held, self.drag.air)
        return total


@lru_cache(maxsize=256)
def _reference(world: NonlinearWorld, time: float) -> Float[Array, "6"]:
    """The reference's state, integrated from the first node in one go; not to be written to."""
    state = world.elements.states(np.array(world.argument_of_latitude))
    if time != 0:
        state = world._integrate(state[None], np.zeros((0, 3)), time, 1)[-1, 0]
    state.flags.writeable = False
    return state
