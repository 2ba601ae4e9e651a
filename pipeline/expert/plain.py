"""The plain SCP, the paper's kind of optimizer: every pair at every node, in one program.

Each round solves one convex program in which a half-space keeps every pair apart at every inner
node, linearized about the trajectory of the round before. Its variables are states and controls of
all craft; Clarabel solves it. Craft are kept apart at the nodes only, as in the paper.
"""

from dataclasses import replace
from time import perf_counter

import clarabel
import numpy as np
from scipy import sparse

from pipeline.errors import InputError
from pipeline.expert.conic import OPTIMAL
from pipeline.expert.cuts import directions
from pipeline.expert.decoupled import control_limit, decoupled_optima
from pipeline.expert.seeds import Seed, checked_seed
from pipeline.orbit.arrays import Controls
from pipeline.orbit.partition import pairs
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import node_collisions
from pipeline.orbit.transfer import fly, fuel, meet_goal, step_maps
from pipeline.plan.judge import Draft, certified_plan
from pipeline.plan.plan import SOLVED, UNSOLVED, Plan
from pipeline.plan.requirements import Requirements
from pipeline.scenario import Scenario

NAME = "plain SCP"
UNIT = 1e-3  # controls are solved for in mm/s²
MARGIN = 1e-3  # separation required beyond r_col, m: more than the solver's rounding
GAP = 1e-3  # optimality gap at which it stops, as in the expert
IMPROVEMENT = 1e-3  # relative improvement at which it stops, as in the expert
MAX_ROUNDS = 20
SIGNS = np.full((2, 1), -1.0), np.array([[1.0], [-1.0]])  # rows u - |u| ≤ 0 and -u - |u| ≤ 0


class PlainScp:
    """Sequential convex programming for one n and one problem, whose matrices are made once.

    The variables of the program are bounds on |u|, then u, then s at both ends and at the inner
    nodes, each by time, component and craft.
    """

    def __init__(self, n: int, problem: Problem) -> None:
        self.n, self.problem = n, problem
        self._pairs, T, one = pairs(n), problem.nodes, sparse.eye_array
        self._bounds, states = 3 * n * problem.intervals, 6 * n * T
        A, B = step_maps(problem)
        ends_first = [0, T - 1, *range(1, T - 1)]
        now, later = (np.eye(T - 1, T, k)[:, ends_first] for k in (0, 1))
        drifted = sparse.block_diag([sparse.kron(each, one(n)) for each in A])
        moved = sparse.kron(later, one(6 * n)) - drifted @ sparse.kron(now, one(6 * n))
        pushed = sparse.block_diag([sparse.kron(UNIT * each, one(n)) for each in B])
        ends = one(12 * n, states)
        self._equal = sparse.block_array(
            [[sparse.csr_array((12 * n, self._bounds)), None, ends], [None, -pushed, moved]]
        )
        either = [sparse.kron(one(T - 1), sparse.kron(sign, one(3 * n))) for sign in SIGNS]
        within = sparse.hstack([*either, sparse.csr_array((2 * self._bounds, states))])
        if problem.max_acceleration is not None:
            within = sparse.vstack([within, one(self._bounds, within.shape[1])])
        self._within = within

    def solve(self, scenario: Scenario, seed: Seed | None = None) -> Plan:
        """Iterate until fuel no longer improves; the cheapest plan without node collisions.

        The seed is node states to linearize about at first, m and m/s. Without one all states are
        zero, so no pair has a direction of its own, and every pair is made to pass radially, the
        craft of lower index above. The plan is UNSOLVED, with the newest iterate, where
        none was clear at the nodes. InputError for another n or problem, or an invalid seed.
        """
        started = perf_counter()
        if (scenario.n, scenario.problem) != (self.n, self.problem):
            raise InputError(
                f"the scenario has {scenario.n} craft and {scenario.problem}; expected what this "
                f"program was compiled for: {self.n} craft and {self.problem}."
            )
        blank = np.zeros((self.n, self.problem.nodes, 6))
        reference = blank if seed is None else checked_seed(scenario, seed)
        optima = decoupled_optima(scenario.initial, scenario.goal, self.problem)
        bound, proof = optima.bound()
        # Solve and linearize anew until an iterate without node collisions is good enough.
        best, least, solves = optima.controls, np.inf, 0
        while solves < MAX_ROUNDS:
            solves += 1
            optimum = self._optimum(scenario, reference)
            if optimum is None:
                break
            controls = meet_goal(scenario.initial, optimum, scenario.goal, self.problem)
            reference = fly(scenario.initial, controls, self.problem)
            if node_collisions(reference, self.problem.collision_radius):
                best = best if np.isfinite(least) else controls
                continue
            used = float(fuel(controls))
            gained, least = least - used, min(least, used)
            if gained > 0:
                best = controls
            if used <= (1 + GAP) * bound or gained <= IMPROVEMENT * used:
                break
        timing = {"plan": perf_counter() - started}
        made = Draft(best, bound, proof, solves, timing)
        plan = certified_plan(NAME, scenario, made, Requirements("nodes"))
        if np.isfinite(least) and plan.status == SOLVED:
            return plan
        given_up = f"no plan clear at the nodes after {solves} convex solves"
        return replace(plan, status=UNSOLVED, message=given_up)

    def _optimum(self, scenario: Scenario, reference: Seed) -> Controls | None:
        """The program's controls with half-spaces about node states, m/s², or None."""
        apart = self._half_spaces(reference)
        A = sparse.vstack([self._equal, self._within, -apart], format="csc")
        equalities, bounds = self._equal.shape[0], self._bounds
        b, cost = np.zeros(A.shape[0]), np.zeros(A.shape[1])
        b[: 12 * self.n] = np.concatenate([scenario.initial.T, scenario.goal.T]).ravel()
        b[equalities + 2 * bounds :] = control_limit(self.problem) / UNIT
        b[len(b) - apart.shape[0] :] = -(self.problem.collision_radius + MARGIN)
        cost[:bounds] = 1.0
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        # This factorizes these programs in a sixth of the time that Clarabel's default takes.
        settings.direct_solve_method = "qdldl"
        cones = [clarabel.ZeroConeT(equalities), clarabel.NonnegativeConeT(len(b) - equalities)]
        flat = sparse.csc_array((len(cost), len(cost)))
        found = clarabel.DefaultSolver(flat, cost, A, b, cones, settings).solve()
        if str(found.status) not in OPTIMAL:
            return None
        controls = np.asarray(found.x)[bounds : 2 * bounds].reshape(-1, 3, self.n)
        return np.ascontiguousarray(UNIT * controls.transpose(2, 0, 1))

    def _half_spaces(self, reference: Seed) -> sparse.csr_array:
        """Rows n̂ · (pᵢ - pⱼ) of every pair at every inner node, Eq. 5 linearized."""
        inner, both, n = self.problem.nodes - 2, np.array(self._pairs), self.n
        apart = (reference[both[0], 1:-1] - reference[both[1], 1:-1]).swapaxes(0, 1).reshape(-1, 6)
        normal = directions(apart[:, :3], apart[:, 3:]).reshape(inner, -1, 3)
        time, component = np.arange(2, inner + 2)[:, None, None], np.arange(3)
        column = 2 * self._bounds + 6 * n * time + n * component + both[:, None, :, None]
        row = np.broadcast_to(np.arange(normal[..., 0].size).reshape(inner, -1, 1), column.shape)
        value = np.stack([normal, -normal])
        shape = row[0, ..., 0].size, self._equal.shape[1]
        return sparse.csr_array((value.ravel(), (row.ravel(), column.ravel())), shape)
