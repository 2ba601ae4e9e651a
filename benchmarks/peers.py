"""Programs that one would write in cvxpy, apart at nodes only: a swarm's, and DCCP's procedure."""

import cvxpy as cp
import numpy as np

from pipeline.expert.decoupled import control_limit
from pipeline.expert.plain import UNIT
from pipeline.orbit.approaches import pairs
from pipeline.orbit.transfer import fuel
from pipeline.scenario import Scenario


class SwarmModel:
    """A scenario in cvxpy: variables, dynamics and both ends.

    Attributes:
        states: of all craft at each node, T of (n, 6), m and m/s.
        controls: of all craft in each interval, T-1 of (n, 3), in UNIT.
        objective: Eq. 4, in UNIT.
        constraints: Eq. 2, both ends, and the thrust limit where there is one.
    """

    def __init__(self, scenario: Scenario) -> None:
        n, problem = scenario.n, scenario.problem
        A, B = problem.dynamics.step(problem.time_step)
        self.states = [cp.Variable((n, 6)) for _ in range(problem.nodes)]
        self.controls = [cp.Variable((n, 3)) for _ in range(problem.intervals)]
        self.objective = cp.Minimize(sum(cp.sum(cp.abs(u)) for u in self.controls))
        steps = zip(self.states[:-1], self.controls, self.states[1:], strict=True)
        self.constraints = [
            self.states[0] == scenario.initial,
            self.states[-1] == scenario.goal,
            *(after == s @ A.T + u @ (UNIT * B.T) for s, u, after in steps),
        ]
        if problem.max_acceleration is not None:
            limit = control_limit(problem) / UNIT
            self.constraints += [cp.abs(u) <= limit for u in self.controls]
        first, second = pairs(n)
        self._difference = np.eye(n)[first] - np.eye(n)[second]

    def gaps(self) -> list[cp.Expression]:
        """Position of each pair's first craft relative to its second, at each inner node."""
        if len(self._difference) == 0:
            return []
        return [self._difference @ s[:, :3] for s in self.states[1:-1]]


def solve_dccp(scenario: Scenario) -> float:
    """Fuel of the plan that DCCP's convex-concave procedure converges to, m/s²."""
    import dccp  # noqa: F401  registers the method

    model, radius = SwarmModel(scenario), scenario.problem.collision_radius
    apart = [cp.norm(gap[k]) >= radius for gap in model.gaps() for k in range(gap.shape[0])]
    program = cp.Problem(model.objective, model.constraints + apart)
    program.solve(method="dccp", solver=cp.CLARABEL, seed=0, parallel=False)
    return float(fuel(UNIT * np.stack([u.value for u in model.controls], axis=1)))
