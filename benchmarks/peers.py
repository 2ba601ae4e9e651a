"""Other planners for comparison, each a function from a scenario to controls, m/s².

DCCP and the plain SCP, which keep craft apart at the nodes only; OpenSCvx, set up as in its
examples; and prioritized planning, which repairs the craft's own optima where they meet.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from importlib import import_module
from itertools import combinations
from typing import Any

import cvxpy as cp
import numpy as np
from scipy.optimize import linprog

from pipeline.arrays import Array, Float
from pipeline.errors import InputError, ProlearnError
from pipeline.expert.decoupled import control_limit, decoupled_optima
from pipeline.expert.plain import UNIT, PlainScp
from pipeline.expert.seeds import decoupled_seed
from pipeline.orbit.arrays import Controls
from pipeline.orbit.partition import pairs
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly, transfer_maps
from pipeline.scenario import Scenario

POINTS, MARGIN, SWEEPS, ROUNDS = 8, 0.5, 10, 3
"""Of the repair: points in an interval, m beyond r_col, passes over all craft, tries of each."""


def required_module(module: str, package: str) -> Any:
    """A module of a package that is no dependency; InputError, with what to do, without it."""
    try:
        return import_module(module)
    except ImportError as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == module
        why = "is not installed" if missing else f"cannot be imported ({error})"
        raise InputError(f"{package} {why}; install it: pip install {package}.") from error


class SwarmModel:
    """A scenario in cvxpy: variables (m and m/s, and UNIT), fuel, dynamics, ends, thrust limit."""

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

    def relative_positions(self) -> list[cp.Expression]:
        """Position of each pair's first craft relative to its second, at each inner node."""
        if len(self._difference) == 0:
            return []
        return [self._difference @ s[:, :3] for s in self.states[1:-1]]


def by_dccp(scenario: Scenario) -> Controls:
    """DCCP: the convex-concave procedure, from its own start."""
    required_module("dccp", "dccp")  # registers the method
    model, radius = SwarmModel(scenario), scenario.problem.collision_radius
    separations = [
        cp.norm(gap[k]) >= radius for gap in model.relative_positions() for k in range(gap.shape[0])
    ]
    program = cp.Problem(model.objective, model.constraints + separations)
    try:
        program.solve(method="dccp", solver=cp.CLARABEL, seed=0, parallel=False)
    except cp.SolverError as error:
        raise ProlearnError(f"DCCP found no plan: {error}") from error
    if any(u.value is None for u in model.controls):
        raise ProlearnError(f"DCCP found no plan: it ended as {program.status}")
    return UNIT * np.stack([u.value for u in model.controls], axis=1)


_plain = lru_cache(maxsize=4)(PlainScp)


def by_plain_scp(scenario: Scenario) -> Controls:
    """A plain SCP, the paper's kind of optimizer, from the decoupled optima."""
    found = _plain(scenario.n, scenario.problem).solve(scenario, decoupled_seed(scenario))
    return found.controls


def _sampled(problem: Problem) -> tuple[Float[Array, "S 6 6"], Float[Array, "S 6 m"]]:
    """Transfer maps to POINTS times in each interval, over which controls are constant."""
    K, step = problem.intervals, problem.time_step / POINTS
    maps = transfer_maps(replace(problem, time_step=step, nodes=K * POINTS + 1))
    shared = maps.reach.reshape(-1, 6, K, POINTS, 3).sum(axis=3)
    return maps.drift, shared.reshape(-1, 6, 3 * K)


def by_repair(scenario: Scenario) -> Controls:
    """Prioritized planning: decoupled optima, and craft in conflict planned again in turn.

    Each by one linear program in HiGHS, with half-spaces about its last path at sampled times.
    """
    problem = scenario.problem
    drift, reach = _sampled(problem)
    free = np.einsum("sij,nj->nsi", drift, scenario.initial)
    miss, far = scenario.goal - free[:, -1], problem.collision_radius + MARGIN
    scale = np.repeat([1.0, problem.duration], 3)

    def planned(k: int, rows: Array, floor: Array) -> Array | None:
        ends = scale[:, None] * reach[-1] * UNIT
        return linprog(
            np.ones(2 * ends.shape[1]),
            A_eq=np.hstack([ends, -ends]),
            b_eq=scale * miss[k],
            A_ub=-UNIT * np.hstack([rows, -rows]),
            b_ub=-floor,
            method="highs",
        ).x

    def trajectory(k: int, x: Array) -> tuple[Array, Array]:
        u = UNIT * (x[: len(x) // 2] - x[len(x) // 2 :])
        return u, (free[k] + reach @ u)[:, :3]

    none = np.zeros((0, 3 * problem.intervals)), np.zeros(0)
    own = [planned(k, *none) for k in range(scenario.n)]
    if any(x is None for x in own):
        raise InputError("a craft cannot reach its goal; expected a scenario that it can fly.")
    trajectories = [trajectory(k, x) for k, x in enumerate(own) if x is not None]
    controls, paths = (np.stack(parts) for parts in zip(*trajectories, strict=True))
    for k in np.tile(np.repeat(np.arange(scenario.n), ROUNDS), SWEEPS):
        gap = paths[k] - paths
        distance = np.linalg.norm(gap, axis=2)
        distance[k] = np.inf
        if (distance[:k] > problem.collision_radius).all():
            continue
        j, s = np.nonzero(distance < 4 * far)
        normal = gap[j, s] / distance[j, s, None]
        rows = np.einsum("ci,cim->cm", normal, reach[s, :3])
        floor = far - np.einsum("ci,ci->c", normal, free[k, s, :3] - paths[j, s])
        x = planned(k, rows, floor)
        if x is not None:
            controls[k], paths[k] = trajectory(k, x)
    return controls.reshape(scenario.n, -1, 3)


class OpenScvx:
    """OpenSCvx for one n, problem and size, m, compiled once, with its default settings.

    Thrust is split into what is along axes and against them, so that fuel is linear; nodes are
    equally spaced; constraints hold in continuous time (``ctcs``).
    """

    def __init__(self, n: int, problem: Problem, size: float) -> None:
        ox, e, wide = required_module("openscvx", "openscvx==0.5.2"), problem.mean_motion, 3 * n
        p, v = (ox.State(name, shape=(wide,)) for name in ("position", "velocity"))
        fuel = ox.State("fuel", shape=(1,))
        sides = [
            ox.Control(name, shape=(wide,), parameterization="ZOH") for name in ("along", "against")
        ]
        self._states, self._sides = (p, v, fuel), sides
        for state, most in ((p, 2 * size), (v, 4 * size * e)):
            state.min, state.max = np.full(wide, -most), np.full(wide, most)
        fuel.min, fuel.max = np.zeros(1), np.full(1, 4 * n * size * e)
        for side in sides:
            side.min, side.max = np.zeros(wide), np.full(wide, 8 * size * e**2)
        u = sides[0] - sides[1]
        x = range(0, wide, 3)
        pull = [
            (
                3 * e**2 * p[k] + 2 * e * v[k + 1] + u[k],
                -2 * e * v[k] + u[k + 1],
                -(e**2) * p[k + 2] + u[k + 2],
            )
            for k in x
        ]
        motion = {
            "position": v,
            "velocity": ox.Concat(*(a for each in pull for a in each)),
            "fuel": ox.Sum(sides[0] + sides[1]),
        }
        separations = [
            ox.ctcs(problem.collision_radius <= ox.linalg.Norm(p[i : i + 3] - p[j : j + 3]))
            for i, j in combinations(x, 2)
        ]
        time = ox.Time(0.0, problem.duration, 0.0, problem.duration, uniform_time_grid=True)
        self._make: Callable[[], Any] = lambda: ox.Problem(
            dynamics=motion,
            constraints=separations,
            states=[p, v, fuel],
            controls=sides,
            N=problem.nodes,
            time=time,
            float_dtype="float64",
        )
        self._problem: Any = None

    def solve(self, scenario: Scenario) -> Controls:
        """Controls, starting from each craft's own optimum."""
        problem, n = scenario.problem, scenario.n
        optima = decoupled_optima(scenario.initial, scenario.goal, problem).controls
        states = fly(scenario.initial, optima, problem).swapaxes(0, 1)
        held = np.concatenate([optima, optima[:, -1:]], axis=1).swapaxes(0, 1).reshape(-1, 3 * n)
        spent = problem.time_step * np.abs(held[:-1]).sum(axis=1).cumsum()
        trajectories = states[..., :3].reshape(-1, 3 * n), states[..., 3:].reshape(-1, 3 * n)
        for state, trajectory in zip(self._states, trajectories, strict=False):
            state.guess, state.initial, state.final = trajectory, trajectory[0], trajectory[-1]
        fuel = self._states[-1]
        fuel.initial, fuel.final = np.zeros(1), [("minimize", spent[-1])]
        fuel.guess = np.append(0.0, spent)[:, None]
        for side, sign in zip(self._sides, (1, -1), strict=True):
            side.guess = np.maximum(sign * held, 0.0)
        if self._problem is None:
            self._problem = self._make()
            self._problem.settings.dev.printing = False
            self._problem.initialize()
        self._problem.reset()
        nodes = self._problem.solve().nodes
        u = np.asarray(nodes["along"]) - np.asarray(nodes["against"])
        return u[:-1].reshape(-1, n, 3).swapaxes(0, 1)


_openscvx = lru_cache(maxsize=4)(OpenScvx)


def by_openscvx(scenario: Scenario) -> Controls:
    """OpenSCvx: successive convexification with constraints in continuous time."""
    most = max(np.abs(end[:, :3]).max() for end in (scenario.initial, scenario.goal))
    size = float(2 ** np.ceil(np.log2(most)))  # rounded up, so that few problems are compiled
    return _openscvx(scenario.n, scenario.problem, size).solve(scenario)
