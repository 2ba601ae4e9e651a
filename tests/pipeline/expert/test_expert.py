"""The expert on real scenarios: always safe, near-optimal, repeatable, whatever its seed."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import clarabel
import numpy as np
import pytest
import readable
from judge import Case
from judge.separation import closest_approaches
from one_swarm import least_separation
from scipy.spatial import cKDTree

from pipeline.errors import InputError
from pipeline.expert import BEST, FIRST_SAFE, SEEDS, Settings, solve, solve_many
from pipeline.expert.conic import by_cones
from pipeline.expert.decoupled import goal_miss
from pipeline.expert.scp import Search
from pipeline.expert.seeds import line_seed
from pipeline.expert.solvers import by_simplex
from pipeline.expert.subproblem import UnsolvableError
from pipeline.orbit.dynamics import cw_matrices
from pipeline.orbit.problem import Problem
from pipeline.orbit.rings import pro_states
from pipeline.orbit.transfer import fly
from pipeline.plan.plan import INFEASIBLE, SOLVED, UNSOLVED
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements
from pipeline.planners.classical import Expert
from pipeline.planners.network import Seeded
from pipeline.scenario import FAMILIES, Scenario, draw
from pipeline.scenario.document import document_of

PROBLEM = Problem()


def closest_on_a_grid(plan, problem, samples=200):
    """Least distance of any pair on a fine grid of times, by the closed form."""
    A, B = cw_matrices(problem.mean_motion, np.linspace(0, problem.time_step, samples))
    i, j = np.triu_indices(len(plan.states), 1)
    ds = plan.states[i, :-1] - plan.states[j, :-1]
    du = plan.controls[i] - plan.controls[j]
    gap = np.tensordot(ds, A[:, :3], (2, 2)) + np.tensordot(du, B[:, :3], (2, 2))
    return np.sqrt(np.vecdot(gap, gap).min())


def test_plans_are_safe_at_all_times_and_meet_their_ends():
    for index in range(25):
        scenario = draw("rings", 5, 10, index, PROBLEM)
        plan = solve(scenario)
        assert plan.status == SOLVED
        assert closest_on_a_grid(plan, PROBLEM) > PROBLEM.collision_radius
        assert plan.states[:, 0] == pytest.approx(scenario.initial, abs=1e-9)
        assert plan.states[:, -1] == pytest.approx(scenario.goal, abs=1e-6)
        assert plan.certificate.dynamics_error < 1e-9
        assert 0 <= plan.certificate.optimality_gap < 0.02


def test_a_thousand_craft_are_safe_by_the_judge():
    """Who shares no code with the planner: each pair that is near at one of 121 times a step."""
    plan = solve(draw("rings", 2022, 1000, 0, PROBLEM))
    assert plan.status == SOLVED
    assert plan.states[:, -1] == pytest.approx(plan.scenario.goal, abs=1e-6)
    speed = 1.2 * np.linalg.norm(plan.states[..., 3:], axis=-1).max()  # within intervals, too
    times, near = np.linspace(0, PROBLEM.time_step, 121), set()
    A, B = cw_matrices(PROBLEM.mean_motion, times)
    for k in range(PROBLEM.intervals):
        for free, pushed in zip(A[:, :3], B[:, :3], strict=True):
            there = plan.states[:, k] @ free.T + plan.controls[:, k] @ pushed.T
            near |= cKDTree(there).query_pairs(PROBLEM.collision_radius + speed * times[1])
    assert len(near) > 100
    case = Case.of(document_of(plan.scenario))
    found = closest_approaches(case, plan.states, plan.controls, np.array([*near]).T)
    assert found.low.min() > PROBLEM.collision_radius


@pytest.mark.parametrize("large", [3, 200])
def test_pairs_of_craft_that_stay_need_no_judgement(monkeypatch, large):
    """Where clusters count as large from three craft on, plans are as safe and nearly the same."""
    monkeypatch.setattr("pipeline.expert.scp.LARGE", large)
    for index in range(10):
        plan = solve(draw("rings", 8, 20, index, PROBLEM))
        assert plan.status == SOLVED
        assert closest_on_a_grid(plan, PROBLEM) > PROBLEM.collision_radius
        assert plan.certificate.optimality_gap < 0.02


def test_programs_that_begin_with_the_last_basis_lead_to_plans_as_good(monkeypatch):
    scenarios = [draw("rings", 9, 20, index, PROBLEM) for index in range(10)]
    usual = solve_many(scenarios)
    monkeypatch.setattr("pipeline.expert.clusters.MANY", 2)
    for plan, other in zip(solve_many(scenarios), usual, strict=True):
        assert plan.status == SOLVED
        assert closest_on_a_grid(plan, PROBLEM) > PROBLEM.collision_radius
        assert plan.certificate.fuel == pytest.approx(other.certificate.fuel, rel=1e-3)


def test_the_optimum_is_that_of_the_last_basis_too(monkeypatch):
    """Each program of a search, begun with the last one's basis, against Clarabel's optimum."""
    monkeypatch.setattr("pipeline.expert.clusters.MANY", 2)
    begun = []

    def checked(sub):
        best = by_simplex(sub)
        assert sub.last is not None
        begun.append(bool((~sub.last.row).any()))
        other = by_cones(replace(sub, last=None))
        cost, least = (
            np.abs(one.controls).sum() + sub.penalty * one.slack.sum() for one in (best, other)
        )
        assert cost == pytest.approx(least, rel=1e-5)
        return best

    monkeypatch.setattr("pipeline.expert.scp.by_simplex", checked)
    for index in range(5):
        assert solve(draw("rings", 10, 20, index, PROBLEM)).status == SOLVED
    assert any(begun)  # with half-spaces that were tight before


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_is_solved_safely(family):
    for n, index in ((10, 0), (10, 1), (20, 0)):
        plan = solve(draw(family, 2, n, index, PROBLEM))
        assert plan.status == SOLVED
        assert closest_on_a_grid(plan, PROBLEM) > PROBLEM.collision_radius


def test_at_nodes_only_plans_are_apart_at_the_nodes_and_closer_between():
    asked = Requirements("nodes")
    plans = [solve(draw("rings", 0, 10, k, PROBLEM), requirements=asked) for k in range(10)]
    assert all(plan.status == SOLVED for plan in plans)
    assert all(plan.certificate.node_collisions == 0 for plan in plans)
    assert any(closest_on_a_grid(plan, PROBLEM) < PROBLEM.collision_radius for plan in plans)


def test_all_solvers_lead_to_the_same_plan(monkeypatch):
    """The third is cvxpy's form of the subproblem."""
    scenarios = [draw("rings", 0, 8, index, PROBLEM) for index in range(3)]
    plans = [solve_many(scenarios, settings=Settings(solver=s)) for s in ("simplex", "clarabel")]
    monkeypatch.setattr("pipeline.expert.scp.by_simplex", readable.solve)
    plans.append(solve_many(scenarios))
    for each in zip(*plans, strict=True):
        fuel = [plan.certificate.fuel for plan in each]
        assert max(fuel) == pytest.approx(min(fuel), rel=1e-5)


def test_a_single_craft_flies_its_own_optimum():
    plan = solve(draw("rings", 0, 1, 0, PROBLEM))
    assert plan.status == SOLVED
    assert plan.convex_solves == 0
    assert plan.certificate.optimality_gap == pytest.approx(0, abs=1e-6)


def test_the_same_scenario_gives_the_same_bits_whatever_was_solved_before():
    scenario = draw("rings", 0, 10, 3, PROBLEM)
    first = solve(scenario)
    solve(draw("rings", 0, 10, 4, PROBLEM))
    solve(draw("rings", 0, 10, 3, Problem(time_step=90.0)))
    assert (solve(scenario).controls == first.controls).all()


@pytest.mark.parametrize("name", SEEDS)
def test_every_seed_leads_to_a_safe_plan(name):
    make = SEEDS[name]
    for index in range(5):
        scenario = draw("rings", 0, 10, index, PROBLEM)
        plan = solve(scenario, make and make(scenario))
        assert plan.status == SOLVED
        assert closest_on_a_grid(plan, PROBLEM) > PROBLEM.collision_radius


@pytest.mark.parametrize("separation", ["continuous", "nodes"])
def test_no_plan_is_dearer_than_a_seed_that_is_safe(separation):
    scenarios = [draw("rings", 3, 10, k, Problem()) for k in range(12)]
    settings, asked = replace(FIRST_SAFE, max_rounds=1, margin=3.0), Requirements(separation)
    seeds = solve_many(scenarios, requirements=asked)
    plans = solve_many(scenarios, [seed.states for seed in seeds], settings, asked)
    assert all(plan.status == SOLVED for plan in plans)
    fuel = [[p.certificate.fuel for p in some] for some in (plans, seeds)]
    assert np.all(np.array(fuel[0]) <= np.array(fuel[1]) * (1 + 1e-9))


def test_a_seed_beyond_the_thrust_limit_is_only_aimed_from():
    free = next(s for k in range(9) if solve(s := draw("rings", 3, 10, k, Problem())).convex_solves)
    seed = solve(free)
    limit = 0.8 * np.abs(seed.controls).max()
    limited = replace(free, problem=replace(free.problem, max_acceleration=limit))
    plan = solve(limited, seed.states, FIRST_SAFE)
    assert plan.status == SOLVED
    assert np.abs(plan.controls).max() <= limit * (1 + 1e-9)


def test_a_seed_with_all_craft_in_one_point_is_no_obstacle():
    scenario = draw("rings", 0, 6, 1, PROBLEM)
    plan = solve(scenario, np.zeros((6, 11, 6)))
    assert plan.status == SOLVED


def test_craft_that_would_meet_head_on_are_led_past_each_other():
    """Two craft change places along the orbit: their own optima pass through one point."""
    offsets = np.array([-100.0, 100.0])
    still = pro_states(1e-9, 0.0, np.zeros(2), 0.0, PROBLEM.mean_motion, offsets)
    scenario = Scenario(PROBLEM, still, still[::-1].copy())
    plan = solve(scenario)
    assert plan.status == SOLVED
    assert closest_on_a_grid(plan, PROBLEM) > PROBLEM.collision_radius


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_seed_that_is_not_finite_is_refused(value):
    with pytest.raises(InputError, match="not finite"):
        solve(draw("rings", 0, 2, 0, PROBLEM), np.full((2, 11, 6), value))


def test_a_seed_of_another_shape_is_refused():
    with pytest.raises(InputError, match=r"shape \(2, 11, 6\)"):
        solve(draw("rings", 0, 2, 0, PROBLEM), np.zeros((3, 11, 6)))


def test_plans_keep_the_thrust_limit():
    free = solve(draw("rings", 0, 5, 0, PROBLEM))
    limit = 0.9 * float(np.abs(free.controls).max())
    plan = solve(draw("rings", 0, 5, 0, Problem(max_acceleration=limit)))
    assert plan.status == SOLVED
    assert np.abs(plan.controls).max() <= limit
    assert plan.certificate.fuel_lower_bound >= free.certificate.fuel_lower_bound * (1 - 1e-9)


def test_a_thrust_limit_too_low_is_infeasible_and_names_the_craft():
    plan = solve(draw("rings", 0, 3, 0, Problem(max_acceleration=1e-5)))
    assert plan.status == INFEASIBLE
    assert "craft 0 cannot reach its goal" in plan.message


def test_a_solver_that_gives_up_proves_nothing(monkeypatch):
    """The real solver with one iteration, where with more of them it finds a plan."""
    scenario = draw("rings", 0, 3, 0, Problem(max_acceleration=4e-4))
    assert solve(scenario).status == SOLVED
    real = clarabel.DefaultSettings

    def impatient():
        settings = real()
        settings.max_iter = 1
        return settings

    monkeypatch.setattr(clarabel, "DefaultSettings", impatient)
    plan = solve(scenario)
    assert plan.status == UNSOLVED
    assert "the convex solver found no transfer of craft 0 on its own" in plan.message


def test_craft_that_no_program_keeps_apart_are_unsolved_and_named():
    """Two craft drift through one point within the first interval, and thrust is too weak.

    That no program held them apart proves nothing: each was linear about a trajectory.
    """
    problem = Problem(time_step=60.0, nodes=11, max_acceleration=2e-3)
    start = np.zeros((2, 6))
    start[1, 1], start[1, 4] = 20.0, -2.0
    goal = fly(start, np.zeros((2, 10, 3)), problem)[:, -1]
    plan = solve(Scenario(problem, start, goal))
    assert plan.status == UNSOLVED
    assert "could not keep craft 0 and 1 15 m apart" in plan.message


def test_a_solver_that_fails_at_one_cluster_does_not_drop_the_others(monkeypatch):
    """On their own optima craft 0 and 9 come too close, and so do 6 and 8."""
    scenario, real = draw("rings", 0, 10, 28, PROBLEM), by_simplex
    first = goal_miss(scenario.initial, scenario.goal, PROBLEM)[0]

    def fails_at_the_first(sub):
        if (sub.miss[0] == first).all():
            raise UnsolvableError("the convex solver stopped with NumericalError")
        return real(sub)

    assert solve(scenario).status == SOLVED
    monkeypatch.setattr("pipeline.expert.scp.by_simplex", fails_at_the_first)
    plan = solve(scenario)
    assert plan.status == UNSOLVED
    assert "the convex solver stopped with NumericalError" in plan.message
    assert "craft 0 and 9 come within" in plan.message
    for pair, apart in (([0, 9], False), ([6, 8], True)):
        alone = SimpleNamespace(states=plan.states[pair], controls=plan.controls[pair])
        assert (closest_on_a_grid(alone, PROBLEM) > PROBLEM.collision_radius) == apart


def test_a_search_ends_with_the_cheapest_iterate_that_it_has_seen_safe(monkeypatch):
    """Pressed for the last bit of fuel, programs also give dearer optima, by their tolerance."""
    seen = []
    judge = Search._check

    def watched(self, clusters):
        judge(self, clusters)
        flown = self.iterate.states, self.iterate.controls
        if least_separation(*flown, PROBLEM).bound > PROBLEM.collision_radius:
            seen.append(np.abs(self.iterate.controls).sum())

    monkeypatch.setattr(Search, "_check", watched)
    settings = Settings(gap_tolerance=1e-9, improvement=0.0, margin=0.005)
    for index in (4, 10, 26):
        seen.clear()
        plan = solve(draw("rings", 7, 20, index, PROBLEM), settings=settings)
        assert len(seen) >= 2
        assert np.abs(plan.controls).sum() <= min(seen) * (1 + 1e-12)
        assert (np.diff(seen) <= 1e-12).all()  # but for rounding


def test_stopping_at_the_first_safe_plan_takes_no_more_solves_and_no_less_fuel():
    for index in range(8):
        scenario = draw("rings", 0, 15, index, PROBLEM)
        first = solve(scenario, settings=FIRST_SAFE)
        best = solve(scenario)
        assert first.status == best.status == SOLVED
        assert first.convex_solves <= best.convex_solves
        assert first.certificate.fuel >= best.certificate.fuel * (1 - 1e-5)


def test_a_planner_before_the_expert_gives_the_seed_and_its_name():
    nodes_only = Expert(name="nodes", requirements=Requirements("nodes"))
    scenarios = [draw("rings", 0, 10, k, PROBLEM) for k in range(5)]
    plans = Seeded(nodes_only).plan(scenarios)
    for plan in plans:
        assert plan.planner == ("nodes + expert" if plan.convex_solves else "expert")
    assert {plan.planner for plan in plans} == {"nodes + expert", "expert"}
    assert all(plan.status == SOLVED for plan in plans)
    assert all(plan.timing["plan"] > plan.timing["seed_plan"] for plan in plans)


def test_more_starts_never_cost_fuel_and_sometimes_save_it():
    saved = []
    for index in range(4):
        scenario = draw("rings", 3, 14, index, PROBLEM)
        once, often = solve(scenario), solve(scenario, settings=BEST)
        assert often.status == SOLVED
        assert closest_on_a_grid(often, PROBLEM) > PROBLEM.collision_radius
        saved.append(1 - often.certificate.fuel / once.certificate.fuel)
    assert min(saved) >= -1e-6
    assert max(saved) > 1e-4


def test_a_plan_is_the_same_to_the_bit_alone_and_among_others():
    """Whatever their sizes; with seeds, too, and where a search goes on from other starts."""
    sizes = [(1, 1), (6, 3), (20, 3), (130, 1)]  # more craft than are compared all with all
    scenarios = [
        draw("rings", 5, n, index, PROBLEM) for n, count in sizes for index in range(count)
    ]
    seeds = [line_seed(s) if k % 3 else None for k, s in enumerate(scenarios)]
    ways = [(settings, AT_ALL_TIMES) for settings in (Settings(), FIRST_SAFE, BEST)]
    for way in (*ways, (Settings(), Requirements("nodes"))):
        some = len(scenarios) - (way[0] != Settings())  # the largest in two of the ways
        many = solve_many(scenarios[:some], seeds[:some], *way)
        for scenario, seed, plan in zip(scenarios[:some], seeds[:some], many, strict=True):
            alone = solve(scenario, seed, *way)
            assert np.array_equal(plan.controls, alone.controls)
            assert np.array_equal(plan.states, alone.states)
            assert plan.certificate == alone.certificate
            assert plan.convex_solves == alone.convex_solves


def test_a_scenario_that_cannot_be_does_not_spoil_the_others():
    problem = Problem(max_acceleration=7e-4)
    scenarios = [draw("rings", 0, 4, index, problem) for index in range(8)]
    plans = solve_many(scenarios)
    assert {plan.status for plan in plans} == {SOLVED, INFEASIBLE}
    for scenario, plan in zip(scenarios, plans, strict=True):
        alone = solve(scenario)
        assert (plan.status, plan.message) == (alone.status, alone.message)
        assert np.array_equal(plan.controls, alone.controls)


def test_no_scenarios_have_no_plans():
    assert solve_many([]) == []


@cache
def of_usual_size(settings):
    """A scenario of the default size, and the certificate of its plan with these settings."""
    scenario = draw("rings", 2022, 10, 3, PROBLEM)
    return scenario, solve(scenario, settings=settings).certificate


@pytest.mark.parametrize("settings", [FIRST_SAFE, Settings(), BEST], ids=["first", "", "best"])
@pytest.mark.parametrize(("radius", "rel"), [(150.0, 2e-3), (1.0, 1e-5), (0.01, 2e-3)])
def test_a_smaller_swarm_burns_in_proportion_less(settings, radius, rel):
    """All lengths are scaled alike, so that controls are, too; up to what proofs need in metres."""
    (scenario, usual), scale = of_usual_size(settings), radius / 15
    problem = replace(PROBLEM, collision_radius=radius)
    small = Scenario(problem, scenario.initial * scale, scenario.goal * scale)
    fuel = solve(small, settings=settings).certificate.fuel
    assert usual.optimality_gap > 1e-3
    assert fuel == pytest.approx(usual.fuel * scale, rel=rel)
