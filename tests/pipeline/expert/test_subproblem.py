"""The convex subproblem by simplex, interior points and cvxpy, held against a dense program."""

import signal
from dataclasses import replace

import numpy as np
import pytest
import readable
from highspy import Highs, HighsModelStatus
from scipy.optimize import linprog

from pipeline.expert.conflicts import ConflictDetection, Trajectory
from pipeline.expert.conic import by_cones
from pipeline.expert.cuts import gaps, half_spaces, normals
from pipeline.expert.decoupled import control_limit, control_units, decoupled_optima, goal_miss
from pipeline.expert.solvers import ROWWISE, _highs, by_simplex, new_highs, run
from pipeline.expert.subproblem import Subproblem, UnsolvableError
from pipeline.orbit.partition import swarm_partition
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly, transfer_maps
from pipeline.plan.requirements import AT_ALL_TIMES
from pipeline.scenario import draw


def subproblem(n, index, problem=None, penalty=0.1):
    """A program with the cuts that the own optima of a real scenario call for."""
    problem = problem or Problem()
    scenario = draw("rings", 0, n, index, problem)
    own = decoupled_optima(scenario.initial, scenario.goal, problem)
    states = fly(scenario.initial, own.controls, problem)
    detection = ConflictDetection(problem, AT_ALL_TIMES, swarm_partition((n,)))
    cuts, _ = detection.conflicts(Trajectory(own.controls, states), 25.0)
    normal = normals(cuts, states, own.controls)
    planes = half_spaces(cuts, normal, scenario.initial, problem, 15.0)
    miss = goal_miss(scenario.initial, scenario.goal, problem)
    return Subproblem(
        reach=transfer_maps(problem).reach[-1],
        miss=miss,
        first=cuts.first,
        second=cuts.second,
        row=planes.row,
        required=planes.required,
        limit=control_limit(problem),
        penalty=penalty,
        unit=float(control_units(miss, problem).max()),
        basis=own.basis,
    )


def by_highs(sub):
    """The optimum with the penalty, as one dense linear program in u⁺, u⁻ and slack."""
    n, m, k = sub.shape
    scale, unit = 1 / np.linalg.norm(sub.reach, axis=1), sub.unit
    goals = np.kron(np.eye(n), sub.reach * scale[:, None] * unit)
    along = np.zeros((k, n, m))
    along[np.arange(k), sub.first] = sub.row * unit
    other = sub.row if sub.other is None else sub.other
    along[np.arange(k), sub.second] -= other * unit
    along = along.reshape(k, n * m)
    found = linprog(
        np.concatenate([np.ones(2 * n * m), np.full(k, sub.penalty / unit)]),
        A_ub=-np.hstack([along, -along, np.eye(k)]),
        b_ub=-sub.required,
        A_eq=np.hstack([goals, -goals, np.zeros((6 * n, k))]),
        b_eq=(sub.miss * scale).ravel(),
        bounds=[(0, sub.limit / unit)] * (2 * n * m) + [(0, None)] * k,
    )
    return found.fun * unit


SOLVERS = [by_simplex, by_cones, readable.solve]


def objective(sub, best):
    return np.abs(best.controls).sum() + sub.penalty * best.slack.sum()


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize("index", range(3))
def test_every_solver_finds_the_optimum(solve, index):
    sub = subproblem(12, index)
    best = solve(sub)
    assert objective(sub, best) == pytest.approx(by_highs(sub), rel=1e-6)
    miss = best.controls @ sub.reach.T - sub.miss
    assert np.abs(miss[:, :3]).max() < 1e-3 and np.abs(miss[:, 3:]).max() < 1e-6


@pytest.mark.parametrize("solve", SOLVERS)
def test_and_so_under_a_thrust_limit_and_where_slack_is_cheap(solve):
    sub = subproblem(12, 1, Problem(max_acceleration=3e-3), penalty=1e-5)
    best = solve(sub)
    assert best.slack.max() > 0.1
    assert np.abs(best.controls).max() <= 3e-3 * (1 + 1e-6)
    assert objective(sub, best) == pytest.approx(by_highs(sub), rel=1e-6)


@pytest.mark.parametrize("solve", SOLVERS)
def test_and_so_where_the_second_craft_of_a_half_space_has_a_row_of_its_own(solve):
    """Or no say at all, as one that has arrived, so that both craft of it are the first."""
    sub = subproblem(12, 1)
    rng = np.random.default_rng(0)
    other = sub.row * rng.uniform(0.3, 1.5, size=sub.row.shape)
    second = sub.second.copy()
    other[::3], second[::3] = 0.0, sub.first[::3]
    required = np.maximum(sub.required, 5.0)
    sub = replace(sub, other=other, second=second, required=required)
    best = solve(sub)
    assert np.abs(best.controls).sum() > own_fuel(sub) * 1.001
    assert objective(sub, best) == pytest.approx(by_highs(sub), rel=1e-6)


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize("penalty", [0.1, 1e-5])
def test_and_so_where_few_of_many_half_spaces_are_tight(solve, penalty):
    """Hundreds between four craft, some of which their own optima violate by up to 3 m."""
    sub, rng = subproblem(4, 1, penalty=penalty), np.random.default_rng(0)
    first, k = rng.integers(3, size=400), rng.integers(1, 10, size=400)
    second, normal = rng.integers(first + 1, 4), rng.normal(size=(400, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    row = np.vecmat(normal, transfer_maps(Problem()).reach[k, :3])
    own = by_simplex(sub).controls
    required = np.vecdot(row, own[first] - own[second]) + rng.uniform(-30.0, 3.0, size=400)
    sub = replace(sub, first=first, second=second, row=row, required=required)
    best = solve(sub)
    reached = np.vecdot(row, best.controls[first] - best.controls[second]) + best.slack
    assert (reached >= required - 1e-5).all()
    assert 4 < (best.dual > 1e-6 * best.dual.max()).sum() < 60
    assert best.slack.max() > 0.1
    assert np.abs(best.controls).sum() > np.abs(own).sum() * 1.001
    assert objective(sub, best) == pytest.approx(by_highs(sub), rel=1e-6)
    assert best.dual == pytest.approx(by_simplex(sub).dual, abs=1e-4 * best.dual.max())


def own_fuel(sub):
    """Without half-spaces."""
    free = replace(sub, required=np.full(len(sub.required), -1e6))
    return by_highs(free)


def test_the_decoupled_bases_are_where_few_pivots_are_left():
    """Most of the work of the simplex method is to find them."""
    sub = subproblem(12, 1)
    pivots = []
    for basis in (sub.basis, None):
        by_simplex(replace(sub, basis=basis))
        pivots.append(_highs().getInfo().simplex_iteration_count)
    assert pivots[0] < pivots[1] / 2


@pytest.mark.parametrize("solve", SOLVERS)
def test_a_solution_is_as_far_apart_as_its_half_spaces_ask(solve):
    problem = Problem()
    scenario = draw("rings", 0, 12, 1, problem)
    sub = subproblem(12, 1)
    best = solve(sub)
    assert best.slack.max() < 1e-6
    states = fly(scenario.initial, best.controls.reshape(12, -1, 3), problem)
    own = decoupled_optima(scenario.initial, scenario.goal, problem)
    flown = Trajectory(own.controls, fly(scenario.initial, own.controls, problem))
    detection = ConflictDetection(problem, AT_ALL_TIMES, swarm_partition((12,)))
    cuts, _ = detection.conflicts(flown, 25.0)
    reached = np.linalg.norm(gaps(cuts, states, best.controls.reshape(12, -1, 3)), axis=1)
    assert len(cuts) > 0
    assert reached.min() >= 15.0 - 1e-5


@pytest.mark.parametrize("solve", SOLVERS)
def test_a_limit_that_no_transfer_keeps_is_said_to_be_unsolvable(solve):
    sub = subproblem(3, 0, Problem(max_acceleration=1e-5))
    with pytest.raises(UnsolvableError):
        solve(sub)


@pytest.mark.parametrize("solve", SOLVERS)
def test_a_dual_variable_is_what_a_little_more_separation_costs(solve):
    sub, more = subproblem(12, 1), 1e-2
    best = solve(sub)
    k = int(best.dual.argmax())
    assert best.dual[k] > 0
    required = sub.required.copy()
    required[k] += more
    dearer = solve(replace(sub, required=required))
    grown = objective(sub, dearer) - objective(sub, best)
    assert grown == pytest.approx(best.dual[k] * more, rel=0.05)


def passed(solver, cost, rows, least):
    """Load the linear program min costᵀx with rows x >= least and x >= 0 into HiGHS."""
    k, n = rows.shape
    solver.passModel(
        *(n, k, k * n, ROWWISE, 1, 0.0, cost, np.zeros(n), np.full(n, np.inf)),
        *(least, np.full(k, np.inf), np.arange(0, k * n + 1, n, dtype=np.int32)),
        *(np.tile(np.arange(n), k), rows.ravel(), np.zeros(n, dtype=np.int32)),
    )


def test_a_signal_ends_a_long_program_and_the_next_is_solved():
    rng, size, solver = np.random.default_rng(0), 2000, _highs()
    passed(solver, np.ones(size), rng.uniform(0, 1, (size, size)), rng.uniform(1, 2, size))

    def interrupt(number, frame):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 0.5)
    try:
        with pytest.raises(KeyboardInterrupt):
            run(solver, long=True)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert solver.getModelStatus() == HighsModelStatus.kInterrupt
    solver = _highs()
    passed(solver, np.ones(1), np.full((1, 1), 4.0), np.full(1, 2.0))
    run(solver, long=True)
    assert solver.getModelStatus() == HighsModelStatus.kOptimal
    assert solver.getSolution().col_value == [0.5]


def test_the_solver_is_silent_before_it_can_print_its_header(monkeypatch):
    # Which HiGHS 1.16 does on standard output, where a plan may be, when callbacks are enabled.
    silent = []
    monkeypatch.setattr(
        Highs,
        "enableCallbacks",
        lambda self: silent.append(not self.getOptionValue("output_flag")[1]),
    )
    new_highs()
    assert silent == [True]
