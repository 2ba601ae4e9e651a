"""Decoupled optima: each craft's optimum without the others, the SCP's start and lower bound."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from pipeline.arrays import Array, Float, Int
from pipeline.expert.conic_decoupled import (
    LIMIT_SHARE,
    dual_bounds,
    minimum_fuel_by_cones,
    polished,
    proven_infeasible,
)
from pipeline.expert.cuts import BEYOND, HalfSpaces, corridor_cuts, half_spaces
from pipeline.expert.solvers import by_simplex
from pipeline.expert.subproblem import Basis, Subproblem, UnsolvableError
from pipeline.orbit.arrays import Controls, CraftMask, Formation, PerCraft, Rows
from pipeline.orbit.corridors import Faces, Margins, margins
from pipeline.orbit.decoupled import (
    MinimumFuelTransfers,
    acceleration_scale,
    independent_columns,
    minimum_fuel_by_table,
    transfers_of_bases,
)
from pipeline.orbit.problem import LIMIT_ROUNDING, Problem
from pipeline.orbit.thrust import Limits
from pipeline.orbit.thrust_cost import cost, craft_fuel
from pipeline.orbit.transfer import fly, meet_goal, minimum_energy, transfer_maps
from pipeline.scenario.spacecraft import limits_of
from pipeline.scenario.state_constraints import StateConstraints, state_constraints
from pipeline.scenario.waypoint import Waypoint, node_choices, of_craft

LOOSE = 1e-7  # largest gap between a craft's fuel and its bound, as a share of its fuel
OUTSIDE = 1e-4  # distance outside of a corridor from which a half-space is added, m
CORRIDOR_ROUNDS = 20  # programs of a craft in corridors at most
MOST_COUNTED = 100  # choices of a craft's open times of which corridors are counted
CONVERGED = 1e-4  # largest gain of a bound, as a share, with which these end
# How a lower bound is proven
TABLE = "a dual vertex of each craft's own linear program, by table"
PROGRAM = "multipliers of each craft's own convex program"
INTEGERS = "branch and bound of each craft's own mixed-integer program"
PROOFS = (TABLE, PROGRAM, INTEGERS)


@dataclass(frozen=True, eq=False)
class DecoupledOptima(Rows):
    """The minimum-fuel transfer of each craft without the others."""

    controls: Controls  # m/s²; the minimum-energy transfer where no optimum was found
    lower_bound: Float[Array, "n"]  # proven lower bound on the fuel of each craft, m/s²
    feasible: CraftMask  # whether an optimum was found
    # whether it is proven that the craft cannot make the transfer within the thrust limit, or with
    # any thrust; the solver failed where it is neither feasible nor impossible
    impossible: CraftMask
    proof: Int[Array, "n"]  # of the bound, as an index of PROOFS
    basis: Int[Array, "n 6"] | None = None  # as in ``Subproblem``, without a thrust limit

    def at_least(
        self, bound: PerCraft, impossible: CraftMask, proof: str = PROGRAM
    ) -> "DecoupledOptima":
        """The optima with other bounds where these are higher, and more that are impossible."""
        higher = bound > self.lower_bound
        return replace(
            self,
            lower_bound=np.where(higher, bound, self.lower_bound),
            impossible=self.impossible | impossible,
            proof=np.where(higher, PROOFS.index(proof), self.proof),
        )

    def bound(self, craft: slice = slice(None)) -> tuple[float, str]:
        """Lower bound on the total fuel of some craft, m/s², and how it is proven."""
        return float(self.lower_bound[craft].sum()), PROOFS[self.proof[craft].max()]


def decoupled_optima(
    initial: Formation,
    goal: Formation,
    problem: Problem,
    limits: Limits | None = None,
    constraints: StateConstraints | None = None,
) -> DecoupledOptima:
    """Minimum-fuel transfer of each craft between its two states, m and m/s.

    By ``minimum_fuel`` where the optimum without a thrust limit keeps to the limit, since then it
    is optimal with it too; the others by cone programs. With limits of each craft, all by cone
    programs, and to ``constraints`` where they are given.
    """
    if limits is not None:
        at = constraints or state_constraints(initial, goal, problem, {})
        return limited_optima(minimum_energy(initial, goal, problem), at, problem, limits)
    miss = goal_miss(initial, goal, problem)
    found = minimum_fuel(miss, problem)
    if found is None:
        controls, bound = np.zeros((len(miss), problem.intervals, 3)), np.zeros(len(miss))
        feasible = np.zeros(len(miss), dtype=bool)
    else:
        controls, bound = found.controls, found.bound
        within = np.abs(controls).max(axis=(1, 2)) <= control_limit(problem)
        feasible = found.exact & within
    by_program = found is None or not found.tabled
    proof, hopeless = np.full(len(miss), int(by_program)), np.zeros(len(miss), dtype=bool)
    beyond = np.flatnonzero(~feasible).tolist()
    if beyond:
        at, alike = state_constraints(initial, goal, problem, {}), limits_of((), len(miss), problem)
    for k in beyond:
        one = slice(k, k + 1)  # alone, so that a plan does not depend on others in its batch
        energy = minimum_energy(initial[one], goal[one], problem)
        alone = limited_optima(energy, at[one], problem, alike[one])
        feasible[one], hopeless[one] = alone.feasible, alone.impossible
        controls[one] = alone.controls
        proof[one] = np.maximum(proof[one], alone.lower_bound > bound[one])
        bound[one] = np.maximum(bound[one], alone.lower_bound)
    exact = meet_goal(initial, controls, goal, problem)
    basis = None if found is None else found.basis
    return DecoupledOptima(exact, bound, feasible, hopeless, proof, basis)


def minimum_fuel(miss: Formation, problem: Problem) -> MinimumFuelTransfers | None:
    """Minimum-fuel controls for changes of state, m and m/s, without thrust limit.

    By table or, where that would be too large, by a linear program for each craft. None where
    controls do not reach every state.
    """
    found = minimum_fuel_by_table(miss, problem)
    first = None if found is not None else _first_basis(problem)
    if first is None:
        return found
    try:
        bases = [_optimal_basis(one, problem, first) for one in miss]
    except UnsolvableError:
        return None
    return transfers_of_bases(np.array(bases).reshape(-1, 6), miss, problem)


@lru_cache(maxsize=32)
def _first_basis(problem: Problem) -> Int[Array, "6"] | None:
    """A basis that is dual feasible for the linear program of every craft, or None."""
    columns = independent_columns(problem)
    if columns is None:
        return None
    try:
        return _optimal_basis(1 / acceleration_scale(problem), problem, columns)
    except UnsolvableError:
        return None


def _optimal_basis(
    miss: Float[Array, "6"], problem: Problem, first: Int[Array, "6"]
) -> Int[Array, "6"]:
    """Optimal basis of a craft's linear program, started from another; UnsolvableError if none."""
    reach, none = transfer_maps(problem).reach[-1], np.zeros(0, dtype=int)
    m = reach.shape[1]
    program = Subproblem(
        reach=reach,
        miss=miss[None],
        first=none,
        second=none,
        row=np.zeros((0, m)),
        required=np.zeros(0),
        limit=np.inf,
        penalty=0.0,
        unit=float(control_units(miss[None], problem)[0]),
        last=Basis.of_decoupled(first[None], m, 0),
    )
    found = by_simplex(program).basis
    if found is None:
        raise UnsolvableError("the row of a goal is basic")
    return np.flatnonzero(found.controls)


def limited_optima(
    controls: Controls, at: StateConstraints, problem: Problem, limits: Limits
) -> DecoupledOptima:
    """Decoupled optima by one cone program of all craft, or one for each where bounds are loose.

    The duals of an infeasible program may prove which craft make it so; then the others are solved
    again without them. The controls given are returned for craft without an optimum.
    """
    n = len(at)
    controls, bound = controls.copy(), np.zeros(n)
    feasible, not_possible = np.zeros((2, n), dtype=bool)
    waiting = [np.arange(n)]
    while waiting:
        craft = waiting.pop()
        found, duals = minimum_fuel_by_cones(at[craft], limits[craft], problem)
        if found is None:
            each = [slice(k, k + 1) for k in range(len(craft))]
            each_dual = [(duals[k], at[craft[k]], limits[craft[k]], problem) for k in each]
            not_possible[craft] = [proven_infeasible(*one) for one in each_dual]
            left = craft[~not_possible[craft]]
            waiting += [left] if 0 < len(left) < len(craft) else _one_by_one(left, craft)
            continue
        feasible[craft] = True
        controls[craft] = polished(found, at[craft], limits[craft], problem)
        bound[craft] = dual_bounds(duals, limits[craft], problem)
        # Where required changes differ much in size, the small ones are lost in rounding.
        fuel = cost(controls[craft], problem.thrust).sum(axis=1)
        loose = craft[fuel - bound[craft] > LOOSE * fuel + problem.negligible_fuel]
        waiting += _one_by_one(loose, craft)
    least_delta_v = bound * problem.time_step
    not_possible |= least_delta_v > limits.delta_v * (1 + LIMIT_ROUNDING)
    return DecoupledOptima(
        controls, bound, feasible & ~not_possible, not_possible, np.ones(n, dtype=int)
    )


@dataclass(frozen=True, eq=False)
class CraftInCorridors:
    """Craft, what they must do, and the faces of corridors that they must stay inside of.

    At any one time each face is a half-space of a craft's controls. So a craft has a convex program
    of its own, with the faces and times at which the last program's controls lead farthest outside,
    and by weak duality each of these programs proves a bound.
    """

    initial: Formation  # m and m/s
    at: StateConstraints
    limits: Limits
    faces: Faces
    problem: Problem

    def bounds(self, controls: Controls) -> tuple[PerCraft, CraftMask]:
        """Lower bound on the fuel of each craft, m/s², and which provably cannot stay inside.

        The controls are those of decoupled optima. The bound is 0 for craft that stay inside by
        these, or of which nothing is proven.
        """
        bound, impossible = np.zeros(len(self.initial)), np.zeros(len(self.initial), dtype=bool)
        for k in np.unique(self.faces.craft[self._outside(controls).face]).tolist():
            alone = self._alone(k, self.faces[self.faces.craft == k])
            bound[k], impossible[k] = alone._bound_of_one(controls[k : k + 1])
        dear = bound * self.problem.time_step > self.limits.delta_v * (1 + LIMIT_ROUNDING)
        return bound, impossible | dear

    def least_of_choices(self, optima: DecoupledOptima) -> tuple[DecoupledOptima, CraftMask]:
        """Optima of a craft's choices, one a row, and a mask of those whose bound counts corridors.

        The bound of the cheapest choice is made to count them until the cheapest is one that does,
        or MOST_COUNTED do. The least of all bounds holds for every choice.
        """
        n = len(self.at)
        bound = np.zeros(n)
        impossible, counted = np.zeros((2, n), dtype=bool)
        for _ in range(MOST_COUNTED):
            k = int(np.where(optima.impossible, np.inf, optima.lower_bound).argmin())
            if counted[k] or optima.impossible[k]:
                break
            one = slice(k, k + 1)
            found = self._alone(k, self.faces).bounds(optima.controls[one])
            bound[one], impossible[one] = found
            counted[k] = True
            optima = optima.at_least(bound, impossible)
        return optima, counted

    def _alone(self, k: int, faces: Faces) -> "CraftInCorridors":
        """One of the craft inside of faces."""
        one, its = slice(k, k + 1), replace(faces, craft=np.zeros_like(faces.craft))
        initial, at, limits = self.initial[one], self.at[one], self.limits[one]
        return replace(self, initial=initial, at=at, limits=limits, faces=its)

    def _bound_of_one(self, controls: Controls) -> tuple[float, bool]:
        """As ``bounds``, of a single craft."""
        bound, known = 0.0, []
        for _ in range(CORRIDOR_ROUNDS):
            outside = self._outside(controls)
            if len(outside) == 0:
                break
            known.append(self._half_spaces(outside))
            inside = HalfSpaces.concatenated(known)
            found, duals = minimum_fuel_by_cones(self.at, self.limits, self.problem, inside)
            if found is None:
                return bound, proven_infeasible(duals, self.at, self.limits, self.problem)
            proven = float(dual_bounds(duals, self.limits, self.problem)[0])
            before, bound = bound, max(bound, proven)
            if 0 < bound <= before * (1 + CONVERGED):
                break
            controls = found
        return bound, False

    def _outside(self, controls: Controls) -> Margins:
        """Where controls lead craft farthest outside of each face in each interval."""
        states = fly(self.initial, controls, self.problem)
        found = margins(states, controls, self.problem, self.faces)
        return found[found.margin < -OUTSIDE]

    def _half_spaces(self, outside: Margins) -> HalfSpaces:
        """Half-spaces of the controls that lead inside of faces at these times."""
        cuts = corridor_cuts(outside, self.faces, self.problem.collision_radius)
        normal = self.faces.normal[outside.face]
        return half_spaces(cuts, normal, self.initial, self.problem, BEYOND)


def cheapest_constraints(
    initial: Formation,
    goal: Formation,
    problem: Problem,
    limits: Limits,
    waypoints: Sequence[Waypoint],
    faces: Faces | None = None,
) -> tuple[StateConstraints, Float[Array, "n"]]:
    """Required states of each craft, and a lower bound on its fuel over all choices of open times.

    The bound, m/s², is infinite where no time is open. All choices of a craft are tried; of those
    that faces of corridors may make dearer, the least ones in turn.
    """
    passed, bound = {}, np.full(len(initial), np.inf)
    for craft, some in of_craft(waypoints).items():
        choices = node_choices(some, problem)
        best = choices[0]
        if len(choices) > 1:
            many = [craft] * len(choices)
            ends = initial[many], goal[many], problem
            tried = {k: list(zip(nodes, some, strict=True)) for k, nodes in enumerate(choices)}
            at = state_constraints(*ends, tried)
            optima = decoupled_optima(*ends, limits[many], at)
            counted = np.ones(len(choices), dtype=bool)
            if faces is not None:
                its = faces[faces.craft == craft]
                choice = CraftInCorridors(initial[many], at, limits[many], its, problem)
                optima, counted = choice.least_of_choices(optima)
            fuel = craft_fuel(optima.controls, problem.thrust, limits[many])
            fuel = np.where(optima.feasible, np.maximum(fuel, optima.lower_bound), np.inf)
            # Where none is feasible, one that is not proven impossible.
            best = choices[int(np.lexsort((fuel, optima.impossible | ~counted))[0])]
            bound[craft] = np.where(optima.impossible, np.inf, optima.lower_bound).min()
        passed[craft] = list(zip(best, some, strict=True))
    return state_constraints(initial, goal, problem, passed), bound


def _one_by_one(some: Int[Array, "_"], of: Int[Array, "_"]) -> list[Int[Array, "_"]]:
    """Each of some craft alone; none where that has been tried."""
    return [*some[:, None]] if len(of) > 1 else []


def goal_miss(initial: Formation, goal: Formation, problem: Problem) -> Formation:
    """Change of final state that the controls of each craft must bring about, m and m/s."""
    return goal - np.matvec(transfer_maps(problem).drift[-1], initial)


def control_units(miss: Formation, problem: Problem) -> Float[Array, "n"]:
    """Size of a typical control, m/s²: of each transfer, or to move by the collision radius."""
    least_energy = np.matvec(transfer_maps(problem).to_goal, miss)
    return np.maximum(np.abs(least_energy).max(axis=1), problem.evasive_control)


def control_limit(problem: Problem) -> float:
    """The thrust limit that programs are given, m/s²; infinite where there is none."""
    return np.inf if problem.max_acceleration is None else problem.max_acceleration * LIMIT_SHARE
