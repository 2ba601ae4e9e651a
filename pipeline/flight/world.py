"""Dynamics in which a plan is flown: the linear model, and two-body motion with J2 and drag.

The latter is about a reference orbit of given conditions.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipeline.arrays import Float, fields_as_python, like, tensor
from pipeline.errors import InputError
from pipeline.orbit.chebyshev import NODES, pieces_of
from pipeline.orbit.dynamics import Dynamics
from pipeline.orbit.linearized import LinearizedDynamics
from pipeline.orbit.nonlinear import flown_arcs
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import Reference, radius_at
from pipeline.orbit.reference_orbit import ReferenceOrbit, check_elements
from pipeline.scenario import Scenario
from pipeline.scenario.part_documents import ANGLES

TrialStates = Float[Any, "N 6"]
HeldControls = Float[Any, "N 3"]  # constant over an interval, m/s²
TrialArcs = Float[Any, "N M q 6"]  # at Chebyshev points of M pieces, both ends included
IntervalPart = tuple[float, float]  # two shares of an interval, between which it is flown

WHOLE: IntervalPart = (0.0, 1.0)


@dataclass(frozen=True)
class LinearWorld:
    """Motion by the linear model with which plans are made.

    With a device, arcs are torch tensors on it, in float64.
    """

    dynamics: Dynamics
    device: str | None = None  # "auto", "cpu" or "cuda"; None for numpy

    @property
    def of_obstacles(self) -> "LinearWorld":
        """The same world for obstacles, by numpy: they are few."""
        return replace(self, device=None)

    def arc(
        self, states: TrialStates, controls: HeldControls, interval: int, part: IntervalPart = WHOLE
    ) -> TrialArcs:
        """States over an interval or a part of it, from initial states and constant controls.

        States are x y z vx vy vz in the LVLH frame of the reference orbit, m and m/s; controls are
        accelerations along its axes, m/s², held constant there.
        """
        begin, end = (share * self.dynamics.time_step for share in part)
        h = end - begin
        pieces = pieces_of(self.dynamics.fastest * h)
        share = (np.arange(pieces)[:, None] + (1 + NODES) / 2) / pieces
        A, B = self.dynamics.step(h * share, interval, begin)
        of_state, of_control = A.reshape(-1, 6), B.reshape(-1, 3)
        if self.device is None:
            # The points of a craft are one product, of the same size however many craft there are.
            flown = np.matvec(of_state, states) + np.matvec(of_control, controls)
        else:
            from pipeline.networks.device import torch_device

            there = torch_device(self.device)
            states, controls = tensor(states, there), tensor(controls, there)
            flown = states @ like(of_state, states).T + controls @ like(of_control, states).T
        return flown.reshape(len(states), *A.shape[:-1])


@dataclass(frozen=True)
class NonlinearWorld:
    """Nonlinear motion about an oblate Earth, with drag, relative to a reference.

    States are of n craft, or of the n craft of several trials, one trial after the other.
    """

    orbit: ReferenceOrbit
    time_step: float  # s
    intervals: int
    n: int = 1  # number of craft, whose ballistic coefficients differ

    @property
    def of_obstacles(self) -> "NonlinearWorld":
        """The same world for obstacles, which have the mean ballistic coefficient of the craft."""
        return replace(self, n=1)

    @classmethod
    def of(cls, problem: Problem, n: int) -> "NonlinearWorld":
        """The world of a problem with a reference orbit, for n craft."""
        assert problem.orbit is not None
        return cls(problem.orbit, problem.time_step, problem.intervals, n)

    def arc(
        self, states: TrialStates, controls: HeldControls, interval: int, part: IntervalPart = WHOLE
    ) -> TrialArcs:
        """As ``LinearWorld.arc``; with drag, InputError unless states are those of whole swarms."""
        count = len(states)
        if self.orbit.ballistic is None:
            ballistics = np.zeros(count)
        elif count % self.n:
            raise InputError(f"{count} states are flown; expected a multiple of {self.n} craft.")
        else:
            ballistics = np.tile(self.orbit.ballistics(self.n), count // self.n)
        dynamics, h = LinearizedDynamics(self.orbit, self.time_step, self.intervals), self.time_step
        if part != WHOLE:
            orbit = self.orbit.later((interval + part[0]) * h)
            dynamics, interval = LinearizedDynamics(orbit, (part[1] - part[0]) * h, 1), 0
        return flown_arcs(dynamics, states, controls[:, None], ballistics, interval)[:, 0]


World = LinearWorld | NonlinearWorld  # true dynamics of craft in flight, with the same methods


@dataclass(frozen=True)
class Conditions:
    """Mean elements of the reference orbit at the first node, and its perturbations.

    Its mean semi-major axis follows from the problem's mean motion. The default is a
    sun-synchronous orbit with the mean eccentricity and perigee of a frozen one.

    Attributes:
        eccentricity: from 0 to 0.85.
        inclination_deg: i, deg.
        raan_deg: Ω, right ascension of the ascending node, deg.
        argument_of_perigee_deg: ω, from the ascending node, deg.
        argument_of_latitude_deg: u, from the ascending node to the LVLH frame, deg.
        j2: whether the Earth is oblate.
        ballistic: C_D A/m of the reference, the swarm's mean, m²/kg, or None for no drag.
        spread: relative spread of C_D A/m, linear over the craft: the first has less, the last
            more.
    """

    eccentricity: float = 0.001
    inclination_deg: float = 97.4
    raan_deg: float = 0.0
    argument_of_perigee_deg: float = 90.0
    argument_of_latitude_deg: float = 0.0
    j2: bool = True
    ballistic: float | None = None
    spread: float = 0.1

    def __post_init__(self) -> None:
        fields_as_python(self)
        check_elements(self)

    def about(self, reference: Reference) -> "Conditions":
        """The same conditions with the orientation and phase of a scenario's reference orbit."""
        return replace(
            self,
            inclination_deg=reference.inclination_deg,
            raan_deg=reference.raan_deg % 360,
            argument_of_latitude_deg=reference.argument_of_latitude_deg % 360,
        )

    def orbit(self, problem: Problem) -> ReferenceOrbit:
        """The orbit of a problem's mean motion; InputError where the air model does not reach."""
        return self.sized(radius_at(problem.mean_motion))

    def sized(self, semi_major_axis: float) -> ReferenceOrbit:
        """The reference orbit of these conditions, of a mean semi-major axis, m."""
        fields = vars(self) | ({} if self.ballistic else {"spread": 0.0})
        return ReferenceOrbit.of_mean(semi_major_axis=semi_major_axis, **fields)


def conditions_of(scenario: Scenario, given: Conditions | None = None) -> Conditions:
    """The conditions given, or by default the usual ones with the scenario's reference orbit."""
    usual = Conditions()
    return given or (usual if scenario.reference is None else usual.about(scenario.reference))


def in_world(scenario: Scenario, conditions: Conditions) -> Scenario:
    """The scenario about its own reference orbit, or that of the conditions without one.

    Its ``reference``, if any, then has the osculating angles of that orbit.
    """
    if scenario.problem.orbit is not None:
        return scenario
    problem, reference = problem_in(scenario.problem, conditions), scenario.reference
    if reference is not None:
        angles = (getattr(problem.orbit, name) for name in ANGLES)
        reference = Reference(reference.epoch, *angles)
    return replace(scenario, problem=problem, reference=reference)


def problem_in(problem: Problem, conditions: Conditions) -> Problem:
    """The problem about its own reference orbit, or that of the conditions without one."""
    return problem if problem.orbit is not None else problem.about(conditions.orbit(problem))


def world_of(scenario: Scenario, conditions: Conditions) -> NonlinearWorld:
    """The world about a scenario's own reference orbit, or that of the conditions without one."""
    return NonlinearWorld.of(problem_in(scenario.problem, conditions), scenario.n)
