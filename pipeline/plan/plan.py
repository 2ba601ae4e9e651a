"""A plan, its status, and its summary."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from math import inf
from operator import truediv
from typing import Any, get_args

import numpy as np

from pipeline.arrays import Array, Float, as_floats
from pipeline.errors import InputError, check_choice, check_kind
from pipeline.orbit.arrays import Controls, States
from pipeline.orbit.thrust import COMPONENTS, NORM
from pipeline.plan.certificate import Certificate
from pipeline.plan.requirements import Requirements, SeparationKind
from pipeline.scenario import Scenario

SOLVED = "solved"  # dynamics, both ends in all six components, thrust limit and separation all hold
UNSAFE = "unsafe"  # flies to the goal, but misses what is required; the message says what
# Proven: some craft cannot reach its goal, a pair is too close at an end, the only controls there
# are bring craft together, or a craft comes too close to another after a loss of thrust, whatever
# the plan; the message says which
INFEASIBLE = "infeasible"
UNSOLVED = "unsolved"  # no safe plan and no proof that there is none; the message says why
STATUSES = (SOLVED, UNSAFE, INFEASIBLE, UNSOLVED)
WITHOUT_GAP = frozenset({INFEASIBLE, UNSOLVED})  # statuses without a plan that has a gap
# Fields of the certificate in a summary
SUMMARY = (
    *("fuel", "delta_v", "craft_delta_v", "craft_delta_v_2norm", "fuel_lower_bound"),
    *("min_separation", "min_separation_pair", "min_separation_time"),
    *("min_separation_bound", "craft_delta_v_thrusters"),
)


@dataclass(frozen=True)
class Assignment:
    """The assignment of goals to craft, where the craft of a scenario are interchangeable.

    The plan is for the scenario with its goals in the order of ``slots``; its certificate's lower
    bound on the fuel holds for every order.

    Attributes:
        slots: of each craft, the row of the scenario's given goals that it takes.
        rank: its place among all assignments by the sum of decoupled optima, from 1; None where the
            given order was taken without being among those looked at.
        tried: number of assignments that were planned.
        given_fuel_lower_bound: lower bound on the fuel of any plan for the given order, m/s²; None
            where some craft provably cannot reach its given goal within the thrust limit.
        saving: share of that bound which the plan saves, at least as much as against any plan for
            the given order; None where there is no such bound or no safe plan.
    """

    slots: tuple[int, ...]
    rank: int | None
    tried: int
    given_fuel_lower_bound: float | None
    saving: float | None


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """States and controls of each craft of a scenario, with certificate and status.

    Attributes:
        scenario: the one planned; its goals in the order of the assignment, where there is one.
        planner: name of the planner.
        status: SOLVED, UNSAFE, INFEASIBLE or UNSOLVED.
        states: node states, m and m/s.
        controls: accelerations held over each interval, m/s².
        certificate: cost, bound and separation.
        convex_solves: number of joint convex programs solved for it.
        timing: seconds by stage; "plan" is from scenario to controls.
        message: why, where the status is not SOLVED.
        assignment: which craft takes which of the given goals, where that was chosen.
        separation: when craft had to be kept apart: at all times, or at the nodes only.
        as_flown: whether states and certificate are of the nonlinear flight about the problem's
            reference orbit, or of linear motion.
    """

    scenario: Scenario
    planner: str
    status: str
    states: States
    controls: Controls
    certificate: Certificate
    convex_solves: int = 0
    timing: Mapping[str, float] = field(default_factory=dict)
    message: str = ""
    assignment: Assignment | None = None
    separation: SeparationKind = "continuous"
    as_flown: bool = False

    def __post_init__(self) -> None:
        for name, kind in KINDS.items():
            check_kind(name, getattr(self, name), kind)
        check_choice("separation", self.separation, get_args(SeparationKind))
        if self.as_flown and self.scenario.problem.orbit is None:
            raise InputError("the plan is as flown about an orbit, and its scenario has none.")
        n, T = self.scenario.n, self.scenario.problem.nodes
        for name, shape in (("states", (n, T, 6)), ("controls", (n, T - 1, 3))):
            object.__setattr__(self, name, _shaped(name, getattr(self, name), shape))

    def __repr__(self) -> str:
        """Planner, status, cost and closest approach; without the arrays."""
        found = self.certificate
        gap = f", gap {self.optimality_gap:z.2%}" if 0 <= self.optimality_gap < inf else ""
        said = [f"{self.scenario.n} craft by {self.planner}, {self.status}"]
        said.append(f"Δv {found.delta_v:.4g} m/s{gap}")
        if found.min_separation_pair is not None:
            i, j = found.min_separation_pair
            at = f"{found.min_separation:.2f} m at {found.min_separation_time:.0f} s"
            said.append(f"closest {i} and {j}, {at}")
        return f"Plan({'; '.join(said)})"

    @property
    def optimality_gap(self) -> float:
        """That of its certificate; infinite where it is UNSOLVED or INFEASIBLE."""
        return inf if self.status in WITHOUT_GAP else self.certificate.optimality_gap

    @cached_property
    def requirements(self) -> Requirements:
        """Requirements on its flight without errors; a risk limit is in the certificate."""
        drifting = self.certificate.passive_safety
        return Requirements(self.separation, None if drifting is None else drifting.orbits)


KINDS: dict[str, Any] = {
    "scenario": Scenario,
    "planner": str,
    "certificate": Certificate,
    "timing": Mapping,
    "message": str,
    "assignment": Assignment | None,
}


def _shaped(name: str, given: Any, shape: tuple[int, ...]) -> Float[Array, "..."]:
    """A plan's array as floats; InputError for what is no numbers, or of another shape."""
    try:
        found = as_floats(given)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} of a plan are no array of numbers: {error}.") from error
    if found.shape != shape:
        raise InputError(
            f"{name} of a plan have shape {found.shape}; expected {shape}, by its scenario."
        )
    return found


def summary(plan: Plan) -> dict[str, Any]:
    """Main figures of a plan, SI units; ``seconds`` is the time that plan and certificate took.

    ``optimality_gap`` is None for an UNSOLVED or INFEASIBLE plan.
    """
    found = plan.certificate
    claims = {name: getattr(found, name) for name in SUMMARY}
    claims["optimality_gap"] = None if plan.status in WITHOUT_GAP else plan.optimality_gap
    optional = {"clearance": found.clearance, "corridor": found.corridor}
    return {
        "planner": plan.planner,
        "status": plan.status,
        "message": plan.message,
        **claims,
        **{name: asdict(one) for name, one in optional.items() if one},
        "passive_safety": found.passive_safety and found.passive_safety.document(),
        "seconds": plan.timing.get("plan", 0.0) + plan.timing.get("certificate", 0.0),
        "risk": found.risk and asdict(found.risk),
        "assignment": plan.assignment and asdict(plan.assignment),
        "largest_share": found.largest_share and asdict(found.largest_share),
        "smallest_burn": found.smallest_burn and asdict(found.smallest_burn),
        "craft_share": _shares(plan),
    }


def _shares(plan: Plan) -> tuple[float, ...]:
    """Share that each craft burns of the Δv it has left; empty where no craft has a limit."""
    found, limits = plan.certificate, plan.scenario.limits
    if limits is None or not np.isfinite(limits.delta_v).any():
        return ()
    model, spent = plan.scenario.problem.thrust.model, found.craft_delta_v_thrusters
    if isinstance(model, str):
        spent = {COMPONENTS: found.craft_delta_v, NORM: found.craft_delta_v_2norm}[model]
    return tuple(map(truediv, spent, limits.delta_v.tolist()))
