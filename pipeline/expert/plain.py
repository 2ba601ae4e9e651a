"""The plain SCP, the paper's kind of optimizer: every pair at every node, in one program.

Each round solves one convex program in which a half-space keeps every pair apart at every inner
node, aimed from the trajectory before. The program is written in cvxpy, compiled once for an n
and a problem, and solved by Clarabel. Craft are kept apart at the nodes only, as in the paper.
"""

import warnings
from dataclasses import dataclass, replace
from time import perf_counter

import cvxpy as cp
import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.expert.cuts import directions
from pipeline.expert.own import control_limit, own_optima
from pipeline.expert.seeds import Seed, checked_seed
from pipeline.orbit.approaches import pairs
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import node_collisions
from pipeline.orbit.transfer import fly, fuel, meet_goal
from pipeline.plan import SOLVED, UNSOLVED, Made, Plan, Requirements, planned
from pipeline.scenario import Scenario

NAME = "plain SCP"

UNIT = 1e-3
"""Controls are solved for in mm/s²."""

MARGIN = 1e-3
"""Separation asked for beyond the collision radius, m: more than the solver's rounding."""

GAP = 1e-3
"""Optimality gap at which it stops, the expert's own rule."""

IMPROVEMENT = 1e-3
"""Relative improvement at which it stops, likewise."""

MAX_ROUNDS = 20

SOLVER = {"solver": cp.CLARABEL, "direct_solve_method": "qdldl", "warm_start": False}
"""QDLDL factorises these programs in a sixth of the time that Clarabel's own choice takes; no warm
start, so that a program's optimum does not depend on what was solved before."""


class SwarmModel:
    """Variables, dynamics and ends of a swarm in cvxpy.

    Attributes:
        states: of all craft at each node, T of (n, 6), m and m/s.
        controls: of all craft in each interval, T-1 of (n, 3), in UNIT.
        initial: parameter (n, 6).
        goal: parameter (n, 6).
        objective: Eq. 4, in UNIT.
        constraints: Eq. 2, both ends, and the thrust limit where there is one.
    """

    def __init__(self, n: int, problem: Problem) -> None:
        A, B = problem.dynamics.step(problem.time_step)
        self.states = [cp.Variable((n, 6)) for _ in range(problem.nodes)]
        self.controls = [cp.Variable((n, 3)) for _ in range(problem.intervals)]
        self.initial, self.goal = cp.Parameter((n, 6)), cp.Parameter((n, 6))
        self.objective = cp.Minimize(sum(cp.sum(cp.abs(u)) for u in self.controls))
        steps = zip(self.states[:-1], self.controls, self.states[1:], strict=True)
        self.constraints = [
            self.states[0] == self.initial,
            self.states[-1] == self.goal,
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

    def set_ends(self, scenario: Scenario) -> None:
        """Give initial and goal states."""
        self.initial.value, self.goal.value = scenario.initial, scenario.goal

    def solution(self) -> Float[Array, "n intervals 3"]:
        """The controls after a solve, m/s²."""
        return UNIT * np.stack([u.value for u in self.controls], axis=1)


@dataclass(frozen=True, eq=False)
class _Found:
    """The cheapest iterate that is clear at the nodes, or the newest where none is."""

    controls: Float[Array, "n intervals 3"] | None = None
    convex_solves: int = 0
    clear: bool = False


class PlainScp:
    """Sequential convex programming for one n and one problem, compiled when it is made."""

    def __init__(self, n: int, problem: Problem) -> None:
        self.n, self.problem = n, problem
        self.model = SwarmModel(n, problem)
        gaps = self.model.gaps()
        self.normals = [cp.Parameter(gap.shape) for gap in gaps]
        apart = [
            cp.sum(cp.multiply(normal, gap), axis=1) >= problem.collision_radius + MARGIN
            for normal, gap in zip(self.normals, gaps, strict=True)
        ]
        self.program = cp.Problem(self.model.objective, self.model.constraints + apart)
        for parameter in self.program.parameters():
            parameter.value = np.zeros(parameter.shape)
        self.program.get_problem_data(cp.CLARABEL)  # compiles

    def solve(self, scenario: Scenario, seed: Seed | None = None) -> Plan:
        """The cheapest plan that is clear at the nodes, when its iterates no longer improve.

        Args:
            scenario: of this n and problem.
            seed: node states (n, T, 6) to aim the first half-spaces from, m and m/s. Without one
                the start is blank: all states are zero, so no pair has a direction of its own,
                and every pair is told to pass radially, the craft of the lower number above.

        Returns:
            A plan that is SOLVED where it is clear at the nodes, and UNSOLVED where no iterate
            was: then it holds the newest one.

        Raises:
            InputError: for a scenario of another n or problem, or a seed of another shape or with
                values that are not finite.
        """
        started = perf_counter()
        if (scenario.n, scenario.problem) != (self.n, self.problem):
            raise InputError(
                f"the scenario has {scenario.n} craft and {scenario.problem}; expected what this "
                f"program was compiled for: {self.n} craft and {self.problem}."
            )
        blank = np.zeros((self.n, self.problem.nodes, 6))
        aim = blank if seed is None else checked_seed(scenario, seed)
        own = own_optima(scenario.initial, scenario.goal, self.problem)
        bound, proof = own.bound(slice(None))
        found = self._search(scenario, aim, bound)
        controls = own.controls if found.controls is None else found.controls
        timing = {"plan": perf_counter() - started}
        made = Made(controls, bound, proof, found.convex_solves, timing)
        plan = planned(NAME, scenario, made, Requirements("nodes"))
        if found.clear and plan.status == SOLVED:
            return plan
        given_up = f"no plan clear at the nodes after {found.convex_solves} convex solves"
        return replace(plan, status=UNSOLVED, message=given_up)

    def _search(self, scenario: Scenario, aim: Seed, bound: float) -> _Found:
        """Solve and aim anew until an iterate that is clear at the nodes is good enough."""
        self.model.set_ends(scenario)
        best, least = _Found(), np.inf
        for solves in range(1, MAX_ROUNDS + 1):
            best = replace(best, convex_solves=solves)
            if not self._solve_program(aim):
                break
            controls = meet_goal(
                scenario.initial, self.model.solution(), scenario.goal, self.problem
            )
            aim = fly(scenario.initial, controls, self.problem)
            if node_collisions(aim, self.problem.collision_radius):
                best = best if best.clear else replace(best, controls=controls)
                continue
            used = float(fuel(controls))
            gained, least = least - used, min(least, used)
            if gained > 0:
                best = _Found(controls, solves, clear=True)
            if used <= (1 + GAP) * bound or gained <= IMPROVEMENT * used:
                break
        return best

    def _solve_program(self, aim: Seed) -> bool:
        """Solve the program with half-spaces aimed from node states; whether it has an optimum."""
        i, j = pairs(len(aim))
        for t, normal in enumerate(self.normals, start=1):
            apart = aim[i, t] - aim[j, t]
            normal.value = directions(apart[:, :3], apart[:, 3:])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # "may be inaccurate": that is judged here
            try:
                self.program.solve(**SOLVER)
            except cp.SolverError:
                return False
        return self.program.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)
