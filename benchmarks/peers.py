"""What one would write instead of the expert: DCCP; the plain SCP is ``pipeline.expert.plain``.

It keeps craft apart at the nodes only, which is less than the expert promises.
"""

import cvxpy as cp

from pipeline.expert.plain import SwarmModel
from pipeline.orbit.transfer import fuel
from pipeline.scenario import Scenario


def solve_dccp(scenario: Scenario) -> float:
    """Fuel of the plan that DCCP's convex-concave procedure converges to, m/s²."""
    import dccp  # noqa: F401  registers the method

    problem = scenario.problem
    model = SwarmModel(scenario.n, problem)
    model.set_ends(scenario)
    apart = [
        cp.norm(gap[pair]) >= problem.collision_radius
        for gap in model.gaps()
        for pair in range(gap.shape[0])
    ]
    program = cp.Problem(model.objective, model.constraints + apart)
    program.solve(method="dccp", solver=cp.CLARABEL, seed=0, parallel=False)
    return float(fuel(model.solution()))
