"""What one would write instead of the expert: SCP plainly in cvxpy, and DCCP.

Both keep craft apart at the nodes only, which is less than the expert promises.
"""

from itertools import combinations

import cvxpy as cp
import numpy as np

from pipeline.expert import own_optima
from pipeline.orbit.cw import cw_matrices
from pipeline.orbit.fuel import fuel
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import node_collisions
from pipeline.orbit.transfer import fly
from pipeline.scenario import Scenario

UNIT = 1e-3
"""Controls are solved for in mm/s²."""

GAP = 1e-3
"""Optimality gap at which the plain SCP stops, the expert's own rule."""

IMPROVEMENT = 1e-3
"""Relative improvement at which it stops, likewise."""

MAX_ROUNDS = 20


class PlainScp:
    """Sequential convex programming with every pair at every node, compiled once for an n."""

    def __init__(self, n: int, problem: Problem) -> None:
        """Build the parametrised program and compile it by a first solve."""
        self.problem = problem
        self.model = _Model(n, problem)
        self.pairs = list(combinations(range(n), 2))
        inner = problem.nodes - 2
        self.normals = [cp.Parameter((inner, 3)) for _ in self.pairs]
        apart = [
            cp.sum(cp.multiply(normal, self.model.gap(i, j)), axis=1) >= problem.collision_radius
            for normal, (i, j) in zip(self.normals, self.pairs, strict=True)
        ]
        self.program = cp.Problem(self.model.objective, self.model.constraints + apart)

    def solve(self, scenario: Scenario) -> float:
        """Fuel of the plan that it converges to, m/s²."""
        own = own_optima(scenario.initial, scenario.goal, self.problem)
        states = fly(scenario.initial, own.controls, self.problem)
        self.model.set_ends(scenario)
        best = np.inf
        for _ in range(MAX_ROUNDS):
            self._aim(states)
            self.program.solve(solver=cp.CLARABEL)
            if self.program.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
                break
            controls = UNIT * np.stack([u.value for u in self.model.controls])
            states = fly(scenario.initial, controls, self.problem)
            used = float(fuel(controls))
            if node_collisions(states, self.problem.collision_radius * (1 - 1e-6)):
                continue
            gained, best = best - used, min(best, used)
            if used <= (1 + GAP) * own.lower_bound.sum() or gained <= IMPROVEMENT * used:
                break
        return best

    def _aim(self, states: np.ndarray) -> None:
        for normal, (i, j) in zip(self.normals, self.pairs, strict=True):
            gap = states[i, 1:-1, :3] - states[j, 1:-1, :3]
            normal.value = gap / np.linalg.norm(gap, axis=1, keepdims=True)


def solve_dccp(scenario: Scenario) -> float:
    """Fuel of the plan that DCCP's convex-concave procedure converges to, m/s²."""
    import dccp  # noqa: F401  registers the method

    problem = scenario.problem
    model = _Model(scenario.n, problem)
    model.set_ends(scenario)
    apart = [
        cp.norm(model.gap(i, j)[t]) >= problem.collision_radius
        for i, j in combinations(range(scenario.n), 2)
        for t in range(problem.nodes - 2)
    ]
    program = cp.Problem(model.objective, model.constraints + apart)
    program.solve(method="dccp", solver=cp.CLARABEL, seed=0, parallel=False)
    controls = UNIT * np.stack([u.value for u in model.controls])
    return float(fuel(controls))


class _Model:
    """Variables, dynamics and ends of a swarm in cvxpy."""

    def __init__(self, n: int, problem: Problem) -> None:
        A, B = cw_matrices(problem.mean_motion, problem.time_step)
        self.states = [cp.Variable((problem.nodes, 6)) for _ in range(n)]
        self.controls = [cp.Variable((problem.intervals, 3)) for _ in range(n)]
        self.initial = [cp.Parameter(6) for _ in range(n)]
        self.goal = [cp.Parameter(6) for _ in range(n)]
        self.objective = cp.Minimize(sum(cp.sum(cp.abs(u)) for u in self.controls))
        self.constraints = []
        for s, u, start, end in zip(
            self.states, self.controls, self.initial, self.goal, strict=True
        ):
            self.constraints += [
                s[0] == start,
                s[-1] == end,
                s[1:] == s[:-1] @ A.T + u @ (UNIT * B.T),
            ]

    def gap(self, i: int, j: int) -> cp.Expression:
        """Relative position of two craft at the inner nodes."""
        return self.states[i][1:-1, :3] - self.states[j][1:-1, :3]

    def set_ends(self, scenario: Scenario) -> None:
        """Give initial and goal states."""
        for k in range(scenario.n):
            self.initial[k].value, self.goal[k].value = scenario.initial[k], scenario.goal[k]
