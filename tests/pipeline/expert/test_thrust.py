"""Thrusters of any kind: least fuel, bounds and verdicts against cvxpy, MILPs and by hand."""

import signal
from dataclasses import asdict, replace
from fractions import Fraction
from functools import cache

import cvxpy as cp
import numpy as np
import pytest
from highspy import HighsModelStatus
from judge.motion import Case, exact_step
from judge.motion import fly as judge_fly
from judge.thrusters import Thrusters
from judged import document, judged
from scipy.optimize import Bounds, LinearConstraint, milp
from thrusting import AXES, EIGHT, FIVE, MODELS, TWELVE, drawn, least, with_thrust

from pipeline.errors import InputError
from pipeline.expert import mixed_integer, solve, solve_many
from pipeline.expert.conic_decoupled import polished
from pipeline.expert.decoupled import INTEGERS, PROGRAM
from pipeline.expert.solvers import new_highs
from pipeline.orbit.decoupled import minimum_limits
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust import Limits, Thrust, blocked_intervals
from pipeline.orbit.thrust_cost import (
    allocated_thrusts,
    conjugate_bound,
    cost,
    support_bound,
    too_small,
)
from pipeline.orbit.transfer import fly
from pipeline.plan.plan import INFEASIBLE, SOLVED
from pipeline.planners.classical import BASELINES
from pipeline.scenario import Scenario, diagnostics, draw
from pipeline.scenario.reach import REACHABLE
from pipeline.scenario.spacecraft import Spacecraft
from pipeline.scenario.state_constraints import timed_constraints
from pipeline.scenario.waypoint import Waypoint

SWARM = draw("rings", 0, 5, 3, Problem())
ONE = replace(SWARM, initial=SWARM.initial[:1], goal=SWARM.goal[:1])
FEW = replace(ONE, problem=Problem(time_step=200.0, nodes=7))
"""With fewer and larger burns, for which mixed-integer programs take less long."""
NAMES = ("components", "norm", "five", "axes")
WINDOW = ((300.0, 500.0),)


def both_limits(model):
    """The scenario of one craft with limits of components and norm that both are active."""
    free = solve(with_thrust(ONE, Thrust(model))).controls
    norm, component = 0.8 * np.linalg.norm(free, axis=2).max(), 0.75 * np.abs(free).max()
    return with_thrust(ONE, Thrust(model, float(norm), no_burn=WINDOW), limit=float(component))


@pytest.mark.parametrize("model", MODELS, ids=NAMES)
def test_one_craft_attains_the_least_fuel_and_its_bound_is_that(model):
    """The judge holds fuel and bound of the certificate to cvxpy's optimum, within 1e-6."""
    for scenario in (with_thrust(ONE, Thrust(model)), both_limits(model)):
        plan = solve(scenario)
        assert plan.status == SOLVED
        assert judged(scenario, plan).wrong == ()
        assert plan.certificate.optimality_gap < 1e-6


@pytest.mark.parametrize("model", MODELS, ids=NAMES)
def test_swarms_keep_to_all_that_is_said_of_thrust(model):
    for thrust in (
        Thrust(model, 0.02, no_burn=WINDOW),
        Thrust(model, objective="fair"),
        Thrust(model, min_delta_v=0.01),
        Thrust(model, 0.02, min_delta_v=0.02),
    ):
        windows = [((0.0, 100.0),) * (k % 2) for k in range(5)]
        own = tuple(Spacecraft(delta_v=100.0, no_burn=one) for one in windows)
        needed = SWARM.problem.time_step * least(with_thrust(SWARM, thrust, own, limit=0.03))
        both = zip(needed, windows, strict=True)
        own = tuple(Spacecraft(delta_v=1.2 * float(one), no_burn=of) for one, of in both)
        scenario = with_thrust(SWARM, thrust, own, limit=0.03)
        plan = solve(scenario)
        assert plan.status == SOLVED, plan.message
        assert judged(scenario, plan).wrong == ()
        assert plan.certificate.optimality_gap < 0.05


@pytest.mark.parametrize("seed", range(24))
def test_a_craft_is_planned_or_proven_infeasible_as_cvxpy_says(seed):
    scenario = drawn(seed, n=1)
    needed = scenario.problem.time_step * least(scenario)[0]
    limits = scenario.limits
    most = np.inf if limits is None else limits.delta_v[0]
    plan = solve(scenario)
    if np.isinf(needed) or needed > most * (1 + 1e-5):
        assert plan.status == INFEASIBLE
    else:
        assert plan.status == SOLVED, plan.message
        assert judged(scenario, plan).wrong == ()
    reach = next(one for one in diagnostics(scenario) if one.rule == REACHABLE)
    if not reach.fine:  # what check says is certain
        assert plan.status == INFEASIBLE


@pytest.mark.parametrize("seed", range(100, 112))
def test_bounds_of_random_swarms_are_never_above_the_least(seed):
    scenario = drawn(seed, n=3)
    plan, own = solve(scenario), least(scenario)
    bound = plan.certificate.fuel_lower_bound
    if np.isfinite(own).all():
        assert bound <= own.sum() * (1 + 1e-6)
    if plan.status == SOLVED:
        assert judged(scenario, plan).wrong == ()
        assert bound >= own.sum() * (1 - 1e-6)


@pytest.mark.parametrize("model", ["norm", FIVE], ids=["norm", "five"])
def test_limits_at_the_edge_decide(model):
    """Just above what a craft needs there is a plan, and just below a proof that there is none."""
    free = with_thrust(ONE, Thrust(model))
    needed = float(least(free)[0]) * ONE.problem.time_step
    weakest = weakest_norm(ONE)
    for share, status in ((1 + 1e-5, SOLVED), (1 - 1e-5, INFEASIBLE)):
        budget = (Spacecraft(delta_v=needed * share),)
        assert solve(replace(free, craft=budget)).status == status
        limited = with_thrust(ONE, Thrust(model, weakest * share))
        assert solve(limited).status == status
        assert np.isinf(least(limited)).any() == (status == INFEASIBLE)


@pytest.mark.parametrize("share", [1.0, 1 - 5e-7, 1 - 2e-6, 0.5])
def test_a_budget_is_judged_beside_a_limit_that_hardly_suffices_or_does_not(share):
    """The program for the least fuel is infeasible where a limit is too low by rounding alone."""
    weakest = float(minimum_limits(ONE.initial, ONE.goal, ONE.problem)[0])
    for budget in (100.0, 1e-3):
        craft = (Spacecraft(delta_v=budget),)
        scenario = with_thrust(ONE, Thrust(), craft, limit=weakest * share)
        reach = next(one for one in diagnostics(scenario) if one.rule == REACHABLE)
        named = [list(case.numbers) for case in reach.cases]
        if share < 1 - 1e-6:
            assert named == [["least_max_acceleration"]]
        else:
            assert named == [["least_delta_v"]] * (budget < 1)


def test_check_knows_that_thrusters_which_cancel_out_in_part_exceed_the_norm():
    """Six thrusters tilted 6° out of a plane, whose thrusts along the normal nearly cancel."""
    turns = np.deg2rad([0, 120, 240])
    flat = [[np.cos(turn), np.sin(turn), up] for up in (0.1, -0.1) for turn in turns]
    model = tuple(tuple((one / np.linalg.norm(one)).tolist()) for one in np.array(flat))
    rise = FEW.problem.mean_motion * FEW.problem.duration
    up = 60 * np.array([np.cos(rise), -FEW.problem.mean_motion * np.sin(rise)])
    ends = np.zeros((2, 1, 6))
    ends[0, 0, 2], ends[1, 0, [2, 5]] = 100.0, up
    scenario = with_thrust(replace(FEW, initial=ends[0], goal=ends[1]), Thrust(model, 3e-4, 0.07))
    plan = solve(scenario)
    assert plan.status == SOLVED, plan.message
    assert plan.certificate.smallest_burn.least > 3e-4 * FEW.problem.time_step
    assert all(one.fine for one in diagnostics(scenario) if one.rule == REACHABLE)


def weakest_norm(scenario):
    """Least limit on the norm with which craft 0 reaches its goal, by cvxpy, m/s²."""
    reach, miss, unit = maps(scenario)
    control = cp.Variable((scenario.problem.intervals, 3))
    most = cp.max(cp.norm(control, 2, axis=1))
    arrives = reach @ cp.vec(control, order="C") == miss
    return unit * cp.Problem(cp.Minimize(most), [arrives]).solve(
        solver=cp.CLARABEL, tol_gap_rel=1e-10, tol_feas=1e-10
    )


def maps(scenario):
    """Effect of the controls of craft 0 on its final state and what they must do; their unit."""
    case = Case.of(document(scenario), scenario.n)
    free, forced = exact_step(case.rate, case.step)
    effects = [forced]
    for _ in range(case.nodes - 2):
        effects.insert(0, free @ effects[0])
    drift = np.linalg.matrix_power(free, case.nodes - 1)
    size, unit = np.repeat([1.0, case.duration], 3), case.duration**-2
    return (
        size[:, None] * np.hstack(effects) * unit,
        size * (scenario.goal - scenario.initial @ drift.T)[0],
        unit,
    )


@pytest.mark.parametrize("model", ["components", FIVE, AXES], ids=["components", "five", "axes"])
@pytest.mark.parametrize("bit", [0.002, 0.02, 0.08])
def test_impulse_bits_of_one_craft_cost_what_a_mixed_integer_program_says(model, bit):
    scenario = with_thrust(FEW, Thrust(model, min_delta_v=bit), limit=0.03)
    plan = solve(scenario)
    assert plan.status == SOLVED, plan.message
    assert judged(scenario, plan).wrong == ()
    proven, attained = least_with_bit(scenario, bit)
    assert plan.certificate.fuel <= (1 + 2e-3) * proven
    bound = plan.certificate.fuel_lower_bound
    assert (1 - 2e-3) * proven <= bound <= attained * (1 + 1e-6)
    assert plan.certificate.smallest_burn.fuel_without == pytest.approx(
        least(with_thrust(FEW, Thrust(model), limit=0.03))[0], rel=1e-6
    )


@pytest.mark.parametrize("longer", [1e-10, 1e-9])
def test_burns_half_orbits_apart_need_not_cancel_what_rounding_leaves_of_their_effect(longer):
    """With steps of half an orbit, thrust along z changes vz by no more than rounding."""
    step = np.pi / ONE.problem.mean_motion * (1 + longer)
    problem = Problem(time_step=step, nodes=6)
    controls = np.zeros((1, 5, 3))
    controls[0, [0, -1]] = np.array([[0.052, 0.101, 0.047], [0.0, 0.032, 0.0]]) / step
    goal = judge_fly(Case.of(asdict(problem)), ONE.initial, controls)[:, -1]
    free = replace(ONE, problem=problem, goal=goal, ends="any")
    between = ((1.5 * step, 3.5 * step),)
    scenario = with_thrust(free, Thrust(min_delta_v=0.03, no_burn=between))
    plan = solve(scenario)
    assert plan.status == SOLVED, plan.message
    assert judged(scenario, plan).faults == ()
    assert plan.certificate.delta_v <= 0.232 * (1 + 1e-3)
    assert 0 <= plan.certificate.optimality_gap <= 1e-3


@cache
def largest_with_bit(model, bit):
    """The largest control of thrusters with a minimum impulse bit and no limit on the norm."""
    free = solve(with_thrust(FEW, Thrust(model, min_delta_v=bit), limit=0.03))
    return float(np.linalg.norm(free.controls, axis=2).max())


@pytest.mark.parametrize("model", ["components", FIVE], ids=["components", "five"])
@pytest.mark.parametrize("share", [0.6, 0.9, 2.0])
def test_impulse_bits_beside_a_limit_on_the_norm_cost_little_more_than_the_least(model, share):
    """The limit as a share of the largest control without one: below 1 it is active.

    Planes that touch the sphere in 200 points give the least fuel, and others slightly inside it
    the plan.
    """
    bit = 0.02
    most = share * largest_with_bit(model, bit)
    scenario = with_thrust(FEW, Thrust(model, most, bit), limit=0.03)
    plan = solve(scenario)
    assert plan.status == SOLVED, plan.message
    assert judged(scenario, plan).wrong == ()
    proven, _ = least_with_bit(scenario, bit)
    assert plan.certificate.fuel <= 1.01 * proven
    # The bound counts the bit or the limit on the norm
    _, attained = least_with_bit(with_thrust(FEW, Thrust(model, None, bit), limit=0.03), bit)
    most = max(attained, least(scenario)[0])
    assert plan.certificate.fuel_lower_bound <= most * (1 + 1e-6)


def test_the_bound_of_a_swarm_with_an_impulse_bit_is_what_its_craft_need_by_such_burns():
    """The reference is a mixed-integer program for each craft; the thrust limit is inactive."""
    few = draw("rings", 0, 2, 4, FEW.problem)
    scenario = with_thrust(few, Thrust(min_delta_v=0.05))
    plan = solve(scenario)
    assert plan.status == SOLVED, plan.message
    assert judged(scenario, plan).wrong == ()
    bounded = with_thrust(few, Thrust(min_delta_v=0.05), limit=0.5)
    alone = [replace(bounded, initial=few.initial[k], goal=few.goal[k]) for k in ([0], [1])]
    needs = np.array([least_with_bit(one, 0.05) for one in alone])
    proven, attained = needs.sum(axis=0)
    bound = plan.certificate.fuel_lower_bound
    assert (1 - 2e-3) * proven <= bound <= attained * (1 + 1e-6)
    assert bound > 1.02 * least(scenario).sum()
    assert plan.certificate.fuel_lower_bound_proof == INTEGERS
    left = np.array([2.0, 3.0])
    craft = tuple(Spacecraft(delta_v=one) for one in left.tolist())
    fair = with_thrust(few, Thrust(min_delta_v=0.05, objective="fair"), craft)
    plan = solve(fair)
    assert judged(fair, plan).wrong == ()
    proven, attained = (few.problem.time_step * needs / left[:, None]).max(axis=0)
    bound = plan.certificate.largest_share.bound
    assert (1 - 2e-3) * proven <= bound <= attained * (1 + 1e-6)


def test_too_little_delta_v_for_burns_as_large_as_the_bit_is_proven():
    scenario = with_thrust(FEW, Thrust(min_delta_v=0.08), limit=0.03)
    proven, attained = least_with_bit(scenario, 0.08)
    step, without = scenario.problem.time_step, least(scenario)[0]
    enough, too_little = (
        replace(scenario, craft=(Spacecraft(delta_v=step * share),))
        for share in (attained * 1.002, proven * 0.998)
    )
    assert proven * 0.99 > without  # so that it would do for smaller burns
    assert solve(enough).status == SOLVED
    plan = solve(too_little)
    assert plan.status == INFEASIBLE
    assert plan.message == (
        "craft 0 cannot reach its goal by burns of at least 0.08 m/s within its limits of thrust "
        "and delta_v, which is proven"
    )


def test_a_bit_beyond_what_the_limit_allows_is_proven_to_leave_no_plan():
    """By hand: at most 0.4 m/s in an interval, and the craft must burn."""
    assert least(with_thrust(FEW, Thrust(), limit=0.002))[0] < np.inf
    plan = solve(with_thrust(FEW, Thrust(min_delta_v=0.41), limit=0.002))
    assert plan.status == INFEASIBLE
    assert plan.message == (
        "craft 0 cannot reach its goal by burns of at least 0.41 m/s within its limits of thrust "
        "and delta_v, which is proven"
    )


@pytest.mark.parametrize("model", ["components", "norm", FIVE], ids=["components", "norm", "five"])
def test_the_only_controls_that_reach_the_goals_decide_whether_a_bit_leaves_a_plan(model):
    """Two intervals: six components, and as many of the final state."""
    grid = Problem(time_step=200.0, nodes=3)
    scenario = with_thrust(replace(ONE, problem=grid), Thrust(model, 10.0))
    thrusters = Thrusters.of(document(scenario), 1)
    fired = thrusters.firings(solve(scenario).controls)
    smallest = 200.0 * fired[fired > 1e-6 * fired.max()].min()
    allowed, refused = (
        solve(with_thrust(scenario, Thrust(model, min_delta_v=share * smallest)))
        for share in (0.999, 1.001)
    )
    assert allowed.status == SOLVED
    assert refused.status == INFEASIBLE
    assert refused.message.startswith(
        "no other controls reach the goals, and with these craft 0 has burns below "
    )


def test_bounds_by_impulse_bits_are_not_claimed_where_waypoints_have_open_times():
    by = (Waypoint(0, (400.0, 500.0, 600.0)),)
    scenario = replace(with_thrust(FEW, Thrust(min_delta_v=0.08), limit=0.1), waypoints=by)
    plan = solve(scenario)
    assert plan.status == SOLVED
    assert plan.certificate.fuel_lower_bound_proof == PROGRAM
    times = [200.0 * node for node in range(1, 6)]
    timed = [replace(scenario, waypoints=(replace(by[0], time=time),)) for time in times]
    fuels = [one.certificate.fuel for one in map(solve, timed) if one.status == SOLVED]
    assert len(fuels) > 1
    assert plan.certificate.fuel_lower_bound <= min(fuels)


@pytest.mark.parametrize(
    "model, index, bit", [(EIGHT, 0, 0.02), (EIGHT, 1, 0.02), (TWELVE, 0, 0.02), (TWELVE, 1, 0.06)]
)
def test_of_redundant_thrusters_those_fire_that_can_by_burns_as_large_as_the_bit(model, index, bit):
    """The same control and sum of thrusts come of many burns, some of them small."""
    problem = Problem(time_step=280.0, nodes=7, thrust=Thrust(model, min_delta_v=bit))
    scenario = draw("rings", 7, 2, index, problem)
    plan = solve(scenario)
    assert plan.status == SOLVED, plan.message
    assert judged(scenario, plan).wrong == ()
    assert plan.certificate.smallest_burn.least >= bit * (1 - 1e-6)


@pytest.mark.parametrize("limit", [np.inf, 0.33])
def test_a_thrust_below_the_bit_is_shared_with_others_if_limits_allow(limit):
    """By hand: on a facet of the cube, two opposite thrusters do what both others do.

    All are at least 0.1 for shifts from 0.1 to 0.34, and at most 0.33 for shifts from 0.17 to 0.28;
    no three of them are at least 0.1.
    """
    facet = np.array([k for k, one in enumerate(EIGHT) if one[2] > 0])[[0, 1, 3, 2]]
    control = np.array([0.5, 0.05, 0.44, 0.0]) @ np.array(EIGHT)[facet]
    problem = Problem(time_step=1.0, thrust=Thrust(EIGHT, min_delta_v=0.1))
    one, burns = np.ones(1), np.ones((1, 1, 3), dtype=bool)
    limits = Limits(limit * one, np.inf * one, np.inf * one, burns)
    (found,) = allocated_thrusts(control.reshape(1, 1, 3), limits, problem)[0]
    shift = found[facet[3]]
    assert found[facet] == pytest.approx([0.5 - shift, 0.05 + shift, 0.44 - shift, shift])
    assert found.sum() == pytest.approx(0.99)
    assert (0.1 <= shift <= 0.34) if limit == np.inf else (0.17 <= shift <= 0.28 + 1e-6)


@pytest.mark.parametrize("model", [EIGHT, TWELVE, (*AXES, *EIGHT)], ids=["8", "12", "14"])
@pytest.mark.parametrize("limit", [1.0, 2.0, np.inf])
def test_thrusts_are_of_the_least_sum_within_limits_and_large_where_the_judge_finds_some(
    model, limit
):
    """Of random controls, each of a craft and by up to six thrusts of at most 1."""
    draws = np.random.default_rng(len(model))
    fired = draws.uniform(0.05, 1.0, (40, len(model))) * (draws.random((40, len(model))) < 0.4)
    burns = (fired @ np.array(model))[:, None]
    bit, each, may = 0.2, np.full(40, limit), np.ones(burns.shape, dtype=bool)
    problem = Problem(time_step=1.0, thrust=Thrust(model, min_delta_v=bit))
    found = allocated_thrusts(burns, Limits(each, np.inf * each, np.inf * each, may), problem)[:, 0]
    judge = Thrusters(np.array(model), each, each, each, may[..., 0], bit, False)
    assert np.allclose(found @ np.array(model), burns[:, 0], rtol=0, atol=1e-9)
    assert found.sum(axis=1) == pytest.approx(judge.firings(burns).sum(axis=(1, 2)), rel=1e-5)
    assert found.max() <= limit * (1 + 2e-6)
    small = ((found > 1e-6) & (found < bit * (1 - 1e-6))).any(axis=1)
    assert (small == judge.smaller(burns, bit)[:, 0]).all()
    assert 0 < small.sum() < 40


@pytest.mark.parametrize("index, bit", [(10, 0.05), (28, 0.05), (8, 0.1), (24, 0.1), (7, 0.2)])
def test_pointed_thrusters_make_burns_larger_where_without_small_ones_craft_would_meet(index, bit):
    swarm = draw("rings", 0, 6, index, Problem(thrust=Thrust("norm", min_delta_v=bit)), "valid")
    plan = solve(swarm)
    assert plan.status == SOLVED, plan.message
    assert judged(swarm, plan).wrong == ()
    size = swarm.problem.time_step * np.linalg.norm(plan.controls, axis=2)
    assert (size[size > 0] >= bit * (1 - 1e-6)).all()


@pytest.mark.parametrize("bit", [0.02, 0.2, 0.4])
def test_burns_are_as_large_as_the_bit_where_there_are_few_intervals(bit):
    """There thrusters would have to fire against each other to make small differences."""
    grid = replace(ONE.problem, nodes=4, time_step=400.0)
    thrust = Thrust(min_delta_v=bit)
    scenario = with_thrust(replace(ONE, problem=grid), thrust, limit=0.03)
    plan = solve(scenario)
    assert plan.status == SOLVED, plan.message
    assert judged(scenario, plan).wrong == ()
    assert plan.certificate.fuel <= (1 + 2e-3) * least_with_bit(scenario, bit)[0]


@pytest.mark.parametrize("bit", [0.2, 1.5])
def test_burns_as_large_as_the_bit_are_found_where_windows_leave_little_time(bit):
    """In the short time left a craft without limits needs some fifty times the usual thrust."""
    grid = replace(ONE.problem, nodes=21, time_step=60.0)
    thrust = Thrust(min_delta_v=bit, no_burn=((0.0, 1020.0),))
    late = with_thrust(replace(ONE, problem=grid), thrust)
    plan = solve(late)
    assert plan.status == SOLVED, plan.message
    assert judged(late, plan).wrong == ()
    drift = np.linalg.matrix_power(exact_step(grid.mean_motion, 60.0)[0], 17)
    rest = replace(ONE, problem=replace(grid, nodes=4), initial=ONE.initial @ drift.T)
    limited = with_thrust(rest, Thrust(min_delta_v=bit), limit=1.0)
    assert plan.certificate.fuel <= (1 + 2e-3) * least_with_bit(limited, bit)[0]


def test_burns_as_large_as_the_bit_are_found_by_waypoints_far_from_both_ends():
    """The craft drifts to its goal without thrust, so waypoints alone make burns necessary."""
    drift = np.linalg.matrix_power(exact_step(ONE.problem.mean_motion, 120.0)[0], 10)
    by = (Waypoint(0, (400.0, 500.0, 600.0), time=600.0),)
    thrust = Thrust(min_delta_v=0.2)
    scenario = with_thrust(replace(ONE, goal=ONE.initial @ drift.T, waypoints=by), thrust)
    plan = solve(scenario)
    assert plan.status == SOLVED, plan.message
    assert plan.certificate.smallest_burn.least >= 0.2 * (1 - 1e-6)
    assert plan.certificate.waypoint_error < 1e-6


def test_burns_as_large_as_the_bit_are_the_same_alone_and_among_others():
    """Rounding decides which burns are dropped, and so which others make up for them."""
    thrust = Thrust(min_delta_v=0.02)
    swarms = [with_thrust(draw("rings", 0, 3, k, Problem()), thrust) for k in (3, 4, 5)]
    for swarm, plan in zip(swarms, solve_many(swarms), strict=True):
        assert (plan.controls == solve(swarm).controls).all()


def test_a_swarm_without_limits_is_planned_by_table_beside_one_that_has_some():
    limited = replace(SWARM, craft=(Spacecraft(delta_v=9.0),) * SWARM.n)
    plan, other = solve_many([SWARM, limited])
    alone = solve(SWARM)
    assert (plan.controls == alone.controls).all()
    assert plan.certificate == alone.certificate
    assert other.scenario is limited


TETRAHEDRON = 3**-0.5 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]])


@pytest.mark.parametrize("index", [0, 1, 2, 4])
def test_fuel_is_not_below_its_bound_where_thrusters_have_limits(index):
    """Each control by hand: the gauge of a regular tetrahedron is 3 max(-u · d)."""
    problem = Problem(
        thrust=Thrust(tuple(map(tuple, TETRAHEDRON.tolist()))), max_acceleration=3.5e-3
    )
    plan = solve(draw("rings", 3, 4, index, problem))
    gauge = 3 * np.max(-plan.controls @ TETRAHEDRON.T, axis=2).sum()
    assert gauge * (1 - 1e-15) <= plan.certificate.fuel <= gauge * (1 + 1e-9)
    assert plan.certificate.optimality_gap >= 0


def test_a_signal_ends_a_search_for_burns_as_large_as_the_bit(monkeypatch):
    """The first program of this swarm takes a third of a second, others 20 s."""
    swarm, begun = with_thrust(draw("rings", 0, 10, 3, Problem()), Thrust(min_delta_v=0.04)), []

    def made(**options):
        begun.append(new_highs(**options))
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        return begun[-1]

    def interrupt(number, frame):
        raise KeyboardInterrupt

    monkeypatch.setattr(mixed_integer, "new_highs", made)
    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        with pytest.raises(KeyboardInterrupt):
            solve(swarm)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert begun[0].getModelStatus() == HighsModelStatus.kInterrupt


def least_with_bit(scenario, bit):
    """Minimum fuel with a minimum impulse bit by a mixed-integer program, m/s².

    A lower bound that HiGHS has proven, at most 0.1 % below, and the fuel that it has found.
    """
    reach, miss, unit = maps(scenario)
    directions = scenario.problem.thrust.directions
    m, K = scenario.problem.intervals, len(directions)
    effect = np.hstack([reach[:, 3 * t : 3 * t + 3] @ directions.T for t in range(m)])
    off, on = np.zeros((6, m * K)), np.eye(m * K)
    least_on = bit / scenario.problem.time_step / unit
    most_on = scenario.problem.max_acceleration / unit
    limits = [
        LinearConstraint(np.hstack([effect, off]), miss - 1e-7, miss + 1e-7),
        LinearConstraint(np.hstack([on, -least_on * on]), 0, np.inf),
        LinearConstraint(np.hstack([on, -most_on * on]), -np.inf, 0),
    ]
    # Thrusters that are opposite do not fire at once, as plans hold their difference alone.
    opposite = [k for k in range(K) if (directions[k] == -directions).all(axis=1).any()]
    once = np.zeros((m * len(opposite), m * K))
    for row, (t, k) in enumerate((t, k) for t in range(m) for k in opposite):
        against = int((directions[k] == -directions).all(axis=1).argmax())
        once[row, [K * t + k, K * t + against]] = 1.0
    limits.append(LinearConstraint(np.hstack([0 * once, once]), 0, 1))
    if (norm := scenario.problem.thrust.max_acceleration_norm) is not None:
        planes = np.kron(np.eye(m), ways() @ directions.T)  # that touch the sphere
        limits.append(LinearConstraint(np.hstack([planes, 0 * planes]), -np.inf, norm / unit))
    found = milp(
        np.repeat([1.0, 0.0], m * K),
        constraints=limits,
        integrality=np.repeat([0, 1], m * K),
        bounds=Bounds(0, np.repeat([most_on, 1.0], m * K)),
        options={"mip_rel_gap": 1e-3, "time_limit": 30},
    )
    return unit * found.mip_dual_bound, unit * found.fun


def ways():
    """200 unit vectors spread over the sphere (Fibonacci's lattice), no point farther than 12°."""
    k = np.arange(200) + 0.5
    turn, height = np.pi * (1 + 5**0.5) * k, 1 - 2 * k / 200
    flat = np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)


def test_a_fair_plan_burns_the_least_largest_share():
    """Craft that do not meet: each one's least fuel, so the least share is the largest of those."""
    left = np.array([0.9, 3.0, 1.2, 2.0, 5.0])
    craft = tuple(Spacecraft(delta_v=float(one)) for one in left)
    scenario = with_thrust(SWARM, Thrust("norm", objective="fair"), craft)
    shares = SWARM.problem.time_step * least(scenario) / left
    found = solve(scenario).certificate.largest_share
    assert found.craft == shares.argmax()
    assert found.bound == pytest.approx(shares.max(), rel=1e-6)
    assert found.share >= found.bound


@pytest.mark.parametrize("index, poor", [(3, 5), (4, 1), (9, 4)])
def test_craft_with_much_left_go_round_one_with_little(index, poor):
    """So the largest share is what one craft needs on its own, and no plan can have less."""
    swarm = with_thrust(draw("rings", 0, 10, index, Problem()), Thrust("norm"))
    needed = swarm.problem.time_step * least(swarm)
    left = np.where(np.arange(10) == poor, 2 * needed, 50 + 40 * needed)
    total = np.array(solve(swarm).certificate.craft_delta_v_2norm) / left
    craft = tuple(Spacecraft(delta_v=float(one)) for one in left)
    fair = with_thrust(swarm, Thrust("norm", objective="fair"), craft)
    plan = solve(fair)
    assert judged(fair, plan).wrong == ()
    assert total.max() > 0.52
    assert plan.certificate.largest_share.share == pytest.approx(0.5, rel=1e-6)


@pytest.mark.parametrize("model", MODELS, ids=NAMES)
def test_a_scenario_is_planned_in_a_batch_as_it_is_alone(model):
    """Where only some scenarios of a batch have limits of their own."""
    thrust = Thrust(model)
    own = tuple(Spacecraft(delta_v=3.0 + 0.3 * k) for k in range(5))
    batch = [with_thrust(SWARM, thrust), with_thrust(SWARM, thrust, own)]
    batch.append(with_thrust(draw("rings", 0, 5, 4, Problem()), thrust))
    for scenario, plan in zip(batch, solve_many(batch), strict=True):
        alone = solve(scenario)
        assert plan.status == alone.status == SOLVED
        assert plan.certificate.fuel == pytest.approx(alone.certificate.fuel, rel=1e-6)
        assert judged(scenario, plan).wrong == ()


def test_bounds_are_tight_where_craft_move_by_very_different_lengths():
    scale = np.array([1.0, 1e-3, 1e-5])[:, None]
    apart = np.array([0.0, 500.0, 1000.0])[:, None] * np.eye(6)[1]
    ends = (SWARM.initial[:3] * scale + apart, SWARM.goal[:3] * scale + apart)
    scenario = Scenario(Problem(thrust=Thrust("norm")), *ends)
    plan = solve(scenario)
    step = scenario.problem.time_step
    np.testing.assert_allclose(
        plan.certificate.craft_delta_v_2norm, step * least(scenario), rtol=1e-5
    )
    for k in range(3):
        alone = solve(
            replace(scenario, initial=scenario.initial[k : k + 1], goal=ends[1][k : k + 1])
        )
        assert alone.certificate.optimality_gap < 1e-6


@pytest.mark.parametrize("model", MODELS, ids=NAMES)
def test_craft_that_are_at_their_goals_burn_nothing(model):
    state = np.array([[0.0, 100.0 * k, 0, 0, 0, 0] for k in range(3)])
    craft = tuple(Spacecraft(delta_v=1.0, no_burn=((0.0, 1200.0),)) for _ in range(3))
    thrust = Thrust(model, 1e-3, 1e-2, objective="fair")
    plan = solve(with_thrust(Scenario(Problem(), state, state), thrust, craft, limit=1e-3))
    assert plan.status == SOLVED
    assert np.all(plan.controls == 0)
    assert plan.certificate.largest_share.share == 0
    assert plan.certificate.smallest_burn.least is None


@pytest.mark.parametrize("model", MODELS, ids=NAMES)
def test_the_worth_of_prices_is_above_what_any_control_within_limits_gains(model):
    rng, thrust = np.random.default_rng(1), Thrust(model)
    for _ in range(30):
        C, N = 10 ** rng.uniform(-1, 1, 2)
        along, split = rng.normal(size=(2, 1, 4, 3)) * 2
        limits = Limits(
            *(np.array([one]) for one in (C, N, np.inf)), np.ones((1, 4, 3), dtype=bool)
        )
        if thrust.directions is None:
            tried = rng.uniform(-C, C, (2000, 3))
            spent = np.linalg.norm(tried, axis=1)
        else:
            z = rng.uniform(0, C, (2000, len(thrust.directions))) * (rng.random((2000, 1)) < 0.7)
            tried, spent = z @ thrust.directions, z.sum(axis=1)
        tried *= np.minimum(1, N / np.maximum(np.linalg.norm(tried, axis=1), 1e-9))[:, None]
        spent = np.minimum(spent, np.inf) if thrust.directions is None else cost(tried, thrust)
        if thrust.directions is None:
            spent = np.linalg.norm(tried, axis=1)
        does = tried @ along[0].T
        assert (
            conjugate_bound(along, split, limits, thrust)[0]
            >= np.maximum(does - spent[:, None], 0).max(axis=0).sum()
        )
        assert support_bound(along, split, limits, thrust)[0] >= does.max(axis=0).sum()


@pytest.mark.parametrize("step", ["0.1", "0.7", "33.3", "66.6", "99.9", "100.1", "111.1", "123.4"])
def test_a_window_without_burns_that_ends_or_begins_at_a_node_touches_no_interval_beyond(step):
    """Times of nodes are multiples of a decimal step, taken exactly by fractions."""
    h, each = float(step), np.arange(20)
    for node in range(1, 20):
        time = float(node * Fraction(step))
        assert np.array_equal(blocked_intervals(((0.0, time),), h, 20), each < node)
        assert np.array_equal(blocked_intervals(((time, 1e12),), h, 20), each >= node)
        assert np.array_equal(blocked_intervals(((0.0, time + 0.01 * h),), h, 20), each <= node)
        instant = ((time, time + 1e-9 * h),)
        assert np.array_equal(blocked_intervals(instant, h, 20), each == node)


def test_limits_about_the_least_are_answered_without_a_warning():
    """For limits just too small Clarabel returns dual variables of 1e150 and more."""
    e = Problem().mean_motion
    ends = [[100.0, 0.0, 100 * np.tan(np.radians(20.0))], [45.0, 0.0, 0.0]]
    initial, goal = (np.array([[x, y, z, 0.0, -2 * e * x, 0.0]]) for x, y, z in ends)
    free = replace(ONE, initial=initial, goal=goal)
    most = float(np.abs(solve(free).controls).max())
    low, high = most / 10, most
    for _ in range(30):
        limit = (low + high) / 2
        plan = solve(with_thrust(free, Thrust(), limit=limit))
        low, high = (low, limit) if plan.status == SOLVED else (limit, high)
    assert high - low < 1e-8 * high


@pytest.mark.parametrize(
    ("directions", "said"),
    [
        (AXES[:3], "thrust has 3 directions; expected 4 to 64"),
        ((*AXES[:5], (0.0, 0.0, -2.0)), r"thrust\[5\] has length 2; expected a direction"),
        ((*AXES[:5], (0.0, 0.0, -1e300)), r"thrust\[5\] has length 1e\+300"),
        (AXES[:5], "do not push all ways"),
    ],
    ids=["few", "long", "endless", "one-sided"],
)
def test_directions_that_are_none_are_refused_in_a_sentence(directions, said):
    with pytest.raises(InputError, match=said):
        Thrust(tuple(directions))


@pytest.mark.parametrize("share", [5e-6, -5e-6, 2.9e-7])
def test_small_burns_stay_where_those_at_the_limit_cannot_make_up_for_them(share):
    """The first and last burn are at the limit, and without the others would have to exceed it.

    For one sign of ``share``. The tolerance of the limit, a millionth, is not used up.
    """
    size, problem = 0.01, replace(ONE.problem, thrust=Thrust(max_acceleration_norm=0.01))
    controls = np.zeros((1, problem.intervals, 3))
    controls[:, [0, -1]] = size / 3**0.5
    controls[:, 1:-1, 1] = share * size
    goal = fly(ONE.initial, controls, problem)[:, -1]
    asked = replace(ONE, problem=problem, goal=goal)
    found = polished(controls, timed_constraints(asked), asked.limits, problem)
    assert np.abs(fly(ONE.initial, found, problem)[:, -1] - goal).max() < 1e-8
    assert np.linalg.norm(found, axis=2).max() <= size * (1 + 9e-7)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("tiny", [1e-20, 1e-9])
def test_any_control_that_is_not_zero_is_a_burn(model, tiny):
    asked = with_thrust(ONE, Thrust(model, min_delta_v=0.1))
    controls = np.zeros((1, asked.problem.intervals, 3))
    controls[0, :2, 2] = 0.01, -0.01
    assert not too_small(controls, asked.limits, asked.problem).any()
    controls[0, 2, 0] = tiny
    assert too_small(controls, asked.limits, asked.problem).any(axis=2).tolist() == [
        [False, False, True] + [False] * (asked.problem.intervals - 3)
    ]


@pytest.mark.parametrize("plans", [solve_many, BASELINES[-1].plan], ids=["expert", "decoupled"])
@pytest.mark.parametrize("thrust", [Thrust("norm"), Thrust(FIVE)])
def test_a_plan_within_limits_of_each_craft_is_the_same_to_the_bit_alone_and_among_others(
    thrust, plans
):
    scenarios = [with_thrust(draw("rings", 0, n, 1, Problem()), thrust, limit=0.01) for n in (3, 6)]
    for scenario, plan in zip(scenarios, plans(scenarios), strict=True):
        (alone,) = plans([scenario])
        assert np.array_equal(plan.controls, alone.controls)
        assert plan.certificate == alone.certificate
