"""Conditions in which a plan is flown: the reference orbit and its perturbations."""

from dataclasses import dataclass, replace

from pipeline.arrays import fields_as_python
from pipeline.flight.world import NonlinearWorld
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import Reference, radius_at
from pipeline.orbit.reference_orbit import ReferenceOrbit, check_elements
from pipeline.scenario import Scenario
from pipeline.scenario.orbit_document import ANGLES


@dataclass(frozen=True)
class Conditions:
    """Mean elements of the reference orbit at the first node, and its perturbations.

    Its mean semi-major axis follows from the problem's mean motion. The default is a
    sun-synchronous orbit with the mean eccentricity and perigee of a frozen one.
    """

    eccentricity: float = 0.001  # from 0 to MOST_ECCENTRIC
    inclination_deg: float = 97.4  # i
    raan_deg: float = 0.0  # Ω
    argument_of_perigee_deg: float = 90.0  # ω, from the ascending node
    argument_of_latitude_deg: float = 0.0  # u, from the ascending node to the LVLH frame
    j2: bool = True  # whether the Earth is oblate
    # C_D A/m in the middle of the swarm and of the reference, m²/kg; None for no drag
    ballistic: float | None = None
    # relative spread of C_D A/m, linear over the craft: the first has less, the last more
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
