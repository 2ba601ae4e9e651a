"""The certificate of a plan: cost, optimality gap, and safety."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from pipeline.orbit.arrays import Controls, PerCraft, States, norm
from pipeline.orbit.corridors import Faces, margins
from pipeline.orbit.covariance import Uncertainty, dispersion
from pipeline.orbit.nearest import Nearest
from pipeline.orbit.nonlinear import NonlinearFlight, least_after_loss_nonlinear
from pipeline.orbit.partition import SwarmPartition, swarm_partition
from pipeline.orbit.passive_safety import least_after_loss
from pipeline.orbit.problem import Problem
from pipeline.orbit.risk import CollisionRisk, collision_risk
from pipeline.orbit.separation import Separation, least_separations, swarm_node_collisions
from pipeline.orbit.thrust import ALONG_AXES
from pipeline.orbit.thrust_cost import burn_sizes, craft_fuel
from pipeline.orbit.transfer import dynamics_defect
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements, RiskLimit, refuse_risk
from pipeline.scenario import Scenario, participants, shared_problem
from pipeline.scenario.waypoint import waypoint_errors

Columns = dict[str, Sequence[Any]]  # fields of certificates, one value for each scenario

FINE = 1e-9  # tolerance, m, of a least separation that is close to the collision radius
# Share of a fuel by which it may be below its bound: by sums in another order, and by misses of
# goals that count as rounding, as the corrections of plans as flown leave them
FUEL_ROUNDING = 1e-9


@dataclass(frozen=True)
class Feedback:
    """Cost of feedback corrections at each node (``pipeline.orbit.feedback``).

    Attributes:
        saturation: bound on the probability that any is beyond the thrust limit, which the bound
            on the risk includes.
        delta_v: mean Δv that they add to the plan's, Σ‖u‖₁Δt of all craft, m/s.
    """

    saturation: float
    delta_v: float


@dataclass(frozen=True)
class Risk:
    """The collision risk of flying a plan with errors, in the linear model.

    Attributes:
        bound: the probability that any pair comes within the collision radius, at any time from
            the first node to the last, is at most this.
        asked: the limit that was required.
        uncertainty: standard deviations of the Gaussian errors.
        sigmas: standard deviations of each pair's separation that the plan was asked to keep
            beyond the collision radius; 0 where the plan was safe enough without.
        fuel_without: fuel of the planner's plan without the risk limit, m/s²; None where it found
            none, or does not plan for the risk.
        feedback: cost of the corrections at each node; None in open loop.
    """

    bound: float
    asked: float
    uncertainty: Uncertainty
    sigmas: float
    fuel_without: float | None
    feedback: Feedback | None = None

    @property
    def kept(self) -> bool:
        """Whether the bound on the risk is within the limit."""
        return self.bound <= self.asked

    def of(self, risk: CollisionRisk, problem: Problem) -> "Risk":
        """The same with the bound of a computed risk."""
        feedback = Feedback(risk.saturation, risk.corrections * problem.time_step)
        return replace(self, bound=risk.total, feedback=self.feedback and feedback)

    def judge(self, states: States, controls: Controls, problem: Problem) -> "Risk":
        """The same for given states, m and m/s, and controls, m/s².

        The collision radius is increased by the deviation from linear motion between nodes.
        """
        closed_loop = self.feedback is not None
        off = 2 * float(norm(dynamics_defect(states, controls, problem)[..., :3]).max())
        if off > FINE and problem.orbit is not None:
            off = 2 * NonlinearFlight(states[:, 0], controls, problem).deviation(states)
        if off > FINE:
            problem = replace(problem, collision_radius=problem.collision_radius + off)
        spread = dispersion(controls, problem, self.uncertainty, closed_loop)
        return self.of(collision_risk(states, controls, problem, spread), problem)

    @classmethod
    def asked_for(cls, limit: RiskLimit, problem: Problem) -> "Risk":
        """A risk limit, with the bound yet to be found for a plan."""
        feedback = Feedback(0.0, 0.0) if limit.closed_loop else None
        return cls(0.0, limit.asked, limit.uncertainty(problem), 0.0, None, feedback)


@dataclass(frozen=True)
class Clearance:
    """Least distance of participants, craft and obstacles, less their sizes.

    For an ellipsoid it is a lower bound on the distance from its surface.

    Attributes:
        min_clearance: least of any pair at any time, m; below 0 where one is too close.
        min_clearance_bound: proven lower bound on it, m.
        craft: number of the craft; after a loss of thrust, the drifting one.
        other: the other craft, or the name of an obstacle.
        time: when, s since the first node.
        node: at which the craft loses its thrust, or None in flight.
    """

    min_clearance: float
    min_clearance_bound: float
    craft: int
    other: int | str
    time: float
    node: int | None = None

    @classmethod
    def of(cls, least: Separation, scenario: Scenario) -> "Clearance | None":
        """The clearance of a least separation; None where all craft have the same size."""
        if not scenario.sized or least.pair is None or least.time is None:
            return None
        (i, j), radius = least.pair, scenario.problem.collision_radius
        other = j if j < scenario.n else scenario.obstacles[j - scenario.n].name
        by = least.distance - radius, least.bound - radius
        return cls(*by, i, other, least.time, least.node)

    def said(self, craft: str) -> str:
        """How close they come, in words."""
        other = f"craft {self.other}" if isinstance(self.other, int) else self.other
        return (
            f"{craft} comes {-self.min_clearance:.6g} m too close to {other} at {self.time:.6g} s"
        )


@dataclass(frozen=True)
class CorridorMargin:
    """Least margin of any craft inside its corridor.

    Attributes:
        min_margin: least distance from a face, at any time of any corridor, m; below 0 outside.
        min_margin_bound: proven lower bound on it, m.
        craft: number of the craft.
        corridor: number of the corridor in the scenario.
        time: when, s since the first node.
    """

    min_margin: float
    min_margin_bound: float
    craft: int
    corridor: int
    time: float

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        states: States,
        controls: Controls,
        flight: NonlinearFlight | None = None,
    ) -> "CorridorMargin | None":
        """The margin of linear motion or of a flight; None where there are no corridors."""
        if not scenario.corridors:
            return None
        problem, faces = scenario.problem, Faces.of(scenario.corridors, scenario.n)
        if flight is not None:
            return cls.in_flight(flight.margin(faces))
        found = margins(states, controls, problem, faces)
        k = int(found.margin.argmin())
        craft, corridor = int(faces.craft[found.face[k]]), int(faces.corridor[found.face[k]])
        time = float(found.interval[k] * problem.time_step + found.offset[k])
        return cls(float(found.margin[k]), float(found.bound.min()), craft, corridor, time)

    @classmethod
    def in_flight(cls, found: Nearest) -> "CorridorMargin":
        """The corridor margin from the least margins of a flight, or of the first of several."""
        least = found.separation()
        assert least.pair is not None and least.time is not None  # every corridor counts sometime
        return cls(least.distance, least.bound, *least.pair, least.time)


@dataclass(frozen=True)
class PassiveSafety:
    """Least distance to others of a craft that has lost its thrust: any craft, at any node.

    Attributes:
        orbits: how long it drifts from that node; the others fly their plan and then drift, too.
        min_separation: least distance of a drifting craft to another at any time, m; None without
            a pair.
        min_separation_bound: proven lower bound on it, m.
        pair: the drifting craft and the other, or None.
        node: at which the first of them loses its thrust, or None; at the last node the plan has
            ended, and both drift on from their goals.
        time: when they are closest, s since the first node, or None.
        clearance: least distance less sizes, where craft have radii of their own or there are
            obstacles.
    """

    orbits: float
    min_separation: float | None = None
    min_separation_bound: float | None = None
    pair: tuple[int, int] | None = None
    node: int | None = None
    time: float | None = None
    clearance: Clearance | None = None

    def document(self) -> dict[str, Any]:
        """The fields for files, without a clearance where there is none."""
        fields = asdict(self)
        if self.clearance is None:
            del fields["clearance"]
        return fields

    @classmethod
    def of(
        cls, orbits: float, least: Separation, clearance: Clearance | None = None
    ) -> "PassiveSafety":
        """The passive safety of a swarm whose least separation after a loss is known."""
        if least.pair is None:
            return cls(orbits, clearance=clearance)
        return cls(
            orbits, least.distance, least.bound, least.pair, least.node, least.time, clearance
        )


@dataclass(frozen=True)
class LargestShare:
    """The largest share of its Δv that a craft burns.

    Attributes:
        craft: number of the craft.
        share: of the Δv it has left.
        bound: lower bound on the largest share of any transfer, safe or not.
    """

    craft: int
    share: float
    bound: float


@dataclass(frozen=True)
class SmallestBurn:
    """The smallest burn of a plan whose burns must reach an impulse bit.

    Attributes:
        asked: least Δv of a thruster's burn in an interval, m/s.
        least: that of the plan, m/s; None where there is no burn.
        fuel_without: fuel of the planner's plan without this requirement, m/s², or None.
    """

    asked: float
    least: float | None
    fuel_without: float | None = None


@dataclass(frozen=True)
class Certificate:
    """Cost, lower bound and safety of a plan, recomputable from the plan and its scenario.

    Attributes:
        fuel: Eq. 4, m/s², or Σ‖u‖₂, or the sum of thrusts, by the scenario's kind of thrust.
        delta_v: time step times fuel, of all craft, m/s.
        fuel_lower_bound: lower bound on the fuel of any transfer, safe or not, m/s².
        optimality_gap: fuel / fuel_lower_bound - 1.
        node_collisions: Eq. 5; by the sizes of participants where these differ.
        min_separation: least distance of any two craft at any time, m; None without a pair.
        min_separation_pair: the two craft that come closest, or None.
        min_separation_time: when, s since the start, or None.
        min_separation_bound: proven lower bound on the distance of any pair at any time, m.
        goal_error: largest miss of any component of a goal position, m.
        goal_velocity_error: largest miss of any component of a goal velocity, m/s.
        waypoint_error: largest miss of any component of a waypoint, m, where there are some.
        waypoint_velocity_error: likewise of velocities, m/s.
        dynamics_error: largest violation of Eq. 2 in position between two nodes, m; 0 for a plan
            as flown, whose states are those of the flight.
        fuel_lower_bound_proof: how the bound is proven, in words.
        risk: the collision risk with errors, in open or closed loop, where a limit was asked for,
            or None.
        passive_safety: how close craft come after a loss of thrust, where that was asked for.
        craft_delta_v: of each craft, ΔtΣₜ‖u[t]‖₁, m/s, for thrusters along the three axes. Early
            files lack it.
        craft_delta_v_2norm: of each craft, ΔtΣₜ‖u[t]‖₂, m/s, for one thruster that is pointed.
        craft_delta_v_thrusters: of each craft, for thrusters of given directions, m/s, where the
            scenario has some. The one for the scenario's kind of thrust sums to delta_v.
        largest_share: largest share of its Δv that a craft burns, for a fair objective, or None.
        smallest_burn: where burns must reach an impulse bit, or None.
        clearance: least distance of participants less their sizes, where craft have radii of their
            own or there are obstacles.
        corridor: how far inside of their corridors craft stay, where there are any.
    """

    fuel: float
    delta_v: float
    fuel_lower_bound: float
    optimality_gap: float
    node_collisions: int
    min_separation: float | None
    min_separation_pair: tuple[int, int] | None
    min_separation_time: float | None
    min_separation_bound: float | None
    goal_error: float
    goal_velocity_error: float
    dynamics_error: float
    fuel_lower_bound_proof: str = ""
    risk: Risk | None = None
    passive_safety: PassiveSafety | None = None
    craft_delta_v: tuple[float, ...] = ()
    craft_delta_v_2norm: tuple[float, ...] = ()
    craft_delta_v_thrusters: tuple[float, ...] = ()
    largest_share: LargestShare | None = None
    smallest_burn: SmallestBurn | None = None
    clearance: Clearance | None = None
    corridor: CorridorMargin | None = None
    waypoint_error: float | None = None
    waypoint_velocity_error: float | None = None


def certify(
    scenarios: Sequence[Scenario],
    states: States,
    controls: Controls,
    bounds: Sequence[tuple[float, str]],
    requirements: Requirements = AT_ALL_TIMES,
    flights: Sequence[NonlinearFlight] = (),
    least_shares: Sequence[float] = (),
) -> list[Certificate]:
    """The certificates of scenarios of one problem, from states and controls of all their craft.

    Bounds are lower bounds on the fuel, m/s², and how they are proven; least shares are lower
    bounds on the largest share, for a fair objective. Passive safety and risk are computed only
    where they are required. Motion is linear, unless flights are given, with the same node states.
    """
    problem, swarms = shared_problem(scenarios), side_by_side(scenarios)
    flown, burned, starts = swarms.split(states), swarms.split(controls), swarms.starts
    columns = _spending(scenarios, controls, bounds, least_shares)
    columns |= _separations(scenarios, states, controls, flights)
    miss = np.abs(states[:, -1] - np.concatenate([s.goal for s in scenarios]))
    misses = np.maximum.reduceat(miss, starts)
    columns["goal_error"] = misses[:, :3].max(axis=1).tolist()
    columns["goal_velocity_error"] = misses[:, 3:].max(axis=1).tolist()
    defect = np.zeros(len(states))
    if not flights:
        defect = np.abs(dynamics_defect(states, controls, problem)[..., :3]).max(axis=(1, 2))
    columns["dynamics_error"] = np.maximum.reduceat(defect, starts).tolist()
    off = [
        waypoint_errors(s.waypoints, one, problem) if s.waypoints else (None, None)
        for s, one in zip(scenarios, flown, strict=True)
    ]
    columns["waypoint_error"], columns["waypoint_velocity_error"] = zip(*off, strict=True)
    in_flights: Sequence[NonlinearFlight | None] = flights or [None] * len(scenarios)
    columns["corridor"] = list(map(CorridorMargin.of, scenarios, flown, burned, in_flights))
    orbits, limit = requirements.passive_safety, requirements.risk
    if orbits is not None:
        adrift = zip(*_least(scenarios, states, controls, flights, orbits), strict=True)
        columns["passive_safety"] = [PassiveSafety.of(orbits, *one) for one in adrift]
    if limit is not None:
        refuse_risk(scenarios, closed_loop=limit.closed_loop)
        asked = Risk.asked_for(limit, problem)
        columns["risk"] = [asked.judge(*part, problem) for part in zip(flown, burned, strict=True)]
    rows = zip(*columns.values(), strict=True)
    return [Certificate(**dict(zip(columns, row, strict=True))) for row in rows]


def side_by_side(scenarios: Sequence[Scenario]) -> SwarmPartition:
    """The partition of all craft into scenarios, without obstacles and sizes."""
    return swarm_partition(tuple(one.n for one in scenarios))


def _spending(
    scenarios: Sequence[Scenario],
    controls: Controls,
    bounds: Sequence[tuple[float, str]],
    least_shares: Sequence[float],
) -> Columns:
    """Fuel and Δv of swarms and craft, lower bounds, and optimality gaps."""
    problem, swarms = scenarios[0].problem, side_by_side(scenarios)
    thrust, step = problem.thrust, problem.time_step
    each = list(zip(swarms.split(controls), scenarios, strict=True))

    def of_craft(values: PerCraft) -> list[tuple[float, ...]]:
        return [tuple(one.tolist()) for one in swarms.split(values)]

    along_axes = np.abs(controls).sum(axis=(1, 2))
    burned = along_axes
    if thrust != ALONG_AXES:
        burned = np.concatenate([craft_fuel(one, thrust, s.limits) for one, s in each])
    used = np.add.reduceat(burned, swarms.starts).tolist()
    least = [
        min(bound, fuel) if bound <= fuel * (1 + FUEL_ROUNDING) else bound
        for fuel, (bound, _) in zip(used, bounds, strict=True)
    ]
    columns: Columns = {
        "fuel": used,
        "delta_v": [fuel * step for fuel in used],
        "fuel_lower_bound": least,
        "fuel_lower_bound_proof": [proof for _, proof in bounds],
        "optimality_gap": [gap_of(*one, problem) for one in zip(used, least, strict=True)],
        "craft_delta_v": of_craft(step * along_axes),
        "craft_delta_v_2norm": of_craft(step * norm(controls).sum(axis=1)),
    }
    if not isinstance(thrust.model, str):
        columns["craft_delta_v_thrusters"] = of_craft(step * burned)
    if thrust.objective == "fair":
        left = np.concatenate([s.limits.delta_v for s in scenarios if s.limits is not None])
        shares = zip(swarms.split(step * burned / left), least_shares, strict=True)
        columns["largest_share"] = [
            LargestShare(int(one.argmax()), float(one.max()), bound) for one, bound in shares
        ]
    if thrust.min_delta_v is not None:
        sizes = [burn_sizes(one, s.limits, problem) for one, s in each if s.limits]
        smallest = [step * float(one[one > 0].min()) if one.any() else None for one in sizes]
        columns["smallest_burn"] = [SmallestBurn(thrust.min_delta_v, one) for one in smallest]
    return columns


def _separations(
    scenarios: Sequence[Scenario],
    states: States,
    controls: Controls,
    flights: Sequence[NonlinearFlight],
) -> Columns:
    """Least separations, at the nodes and at any time, and clearances by sizes of participants."""
    closest, clear = _least(scenarios, states, controls, flights)
    collisions = [0] * len(scenarios)  # at no node, where a pair is farther apart at all times
    radius, unlike = scenarios[0].problem.collision_radius, any(one.unlike for one in scenarios)
    if unlike or any(one.bound <= radius for one in closest):
        collisions = swarm_node_collisions(states, radius, participants(scenarios)).tolist()
    return {
        "node_collisions": collisions,
        "min_separation": [None if one.pair is None else one.distance for one in closest],
        "min_separation_pair": [one.pair for one in closest],
        "min_separation_time": [one.time for one in closest],
        "min_separation_bound": [None if one.pair is None else one.bound for one in closest],
        "clearance": clear,
    }


def _least(
    scenarios: Sequence[Scenario],
    states: States,
    controls: Controls,
    flights: Sequence[NonlinearFlight],
    orbits: float | None = None,
) -> tuple[list[Separation], list[Clearance | None]]:
    """The least separations of craft, and clearances by sizes, in linear motion or flights.

    With orbits, those of a craft that has lost its thrust, over so many of drift.
    """
    problem = scenarios[0].problem

    def least(*, alike: bool) -> list[Separation]:
        if not flights:
            swarms = side_by_side(scenarios) if alike else participants(scenarios)
            if orbits is None:
                return _least_separations(states, controls, problem, swarms)
            return least_after_loss(states, controls, problem, orbits, swarms)
        each = [None if alike else participants([one]) for one in scenarios]
        if orbits is None:
            return list(map(NonlinearFlight.separation, flights, each))
        return [
            least_after_loss_nonlinear(one.states, one.controls, problem, orbits, beside)
            for one, beside in zip(flights, each, strict=True)
        ]

    closest = least(alike=True)
    clear = least(alike=False) if any(one.sized for one in scenarios) else closest
    return closest, list(map(Clearance.of, clear, scenarios))


def gap_of(fuel_used: float, fuel_lower_bound: float, problem: Problem) -> float:
    """Fuel / bound - 1; 0 where neither is more than rounding, infinite where only one is."""
    if fuel_lower_bound > problem.negligible_fuel:
        return fuel_used / fuel_lower_bound - 1
    return 0.0 if fuel_used <= problem.negligible_fuel else float("inf")


def _least_separations(
    states: States, controls: Controls, problem: Problem, swarms: SwarmPartition
) -> list[Separation]:
    """The least separation of each swarm, to a finer tolerance where r_col is within the first."""
    flown, radius = (states, controls, problem, swarms), problem.collision_radius
    closest = least_separations(*flown)
    unsure = [k for k, apart in enumerate(closest) if apart.bound <= radius < apart.distance]
    if unsure:
        finer = least_separations(*flown, tolerance=FINE)
        closest = [finer[k] if k in unsure else apart for k, apart in enumerate(closest)]
    return closest
