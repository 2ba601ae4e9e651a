"""Plans about eccentric orbits under J2, flown by an integrator that the product does not know."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from relative import linear_flight, linear_maps, pull
from trials import Errors, drawn, wilson

from pipeline.expert import solve
from pipeline.flight.world import NonlinearWorld
from pipeline.orbit.partition import pairs, swarm_partition
from pipeline.orbit.passive_safety import Ends, least_after_loss, unavoidable_encounter
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import R_EARTH
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.plan.plan import INFEASIBLE, SOLVED
from pipeline.plan.requirements import Requirements, RiskLimit
from pipeline.planners.named import named_planner
from pipeline.scenario import draw

FORCE = partial(pull, j2=True)

PARTS = 24
"""Looks at each interval: every 5 s."""


@cache
def about(e):
    """The reference problem, near perigee of an orbit."""
    return Problem().about(ReferenceOrbit((R_EARTH + 500e3) / (1 - e), e, 51.6, 40.0, 30.0, 10.0))


def ring(seed, e):
    return replace(draw("rings", seed, 10, 0, Problem()), problem=about(e))


@cache
def flight(e):
    """What flies craft to the plan's end."""
    problem = about(e)
    begin = problem.orbit.states(np.zeros(1))[0]
    return linear_flight(begin, problem.time_step, problem.intervals, PARTS, FORCE)


def positions(flown):
    """Of (..., intervals, parts + 1, 6) in a row, without those that are there twice."""
    inner = flown[..., :-1, :3]
    row = inner.reshape(*inner.shape[:-3], -1, 3)
    return np.concatenate([row, flown[..., -1, -1:, :3]], axis=-2)


@pytest.mark.parametrize("planner", ["expert", "refiner"])
@pytest.mark.parametrize("e", [0.0, 0.1, 0.5, 0.8])
def test_plans_reach_their_goals_apart(planner, e):
    """And the least separation is that of looks every 5 s, between which no craft moves far."""
    for seed in (0, 1):
        scenario = ring(seed, e)
        (plan,) = named_planner(planner).plan([scenario])
        assert plan.status == SOLVED
        flown = flight(e)(scenario.initial, plan.controls)
        np.testing.assert_allclose(flown[:, :, -1], plan.states[:, 1:], rtol=1e-9, atol=1e-7)
        np.testing.assert_allclose(flown[:, -1, -1], scenario.goal, rtol=1e-9, atol=1e-7)
        track, (i, j) = positions(flown), pairs(10)
        apart = np.linalg.norm(track[i] - track[j], axis=-1).min()
        found = plan.certificate
        assert found.min_separation_bound - 1e-6 <= apart < found.min_separation + 0.2
        assert found.min_separation >= 15.0
        assert found.fuel_lower_bound <= found.fuel


@pytest.mark.parametrize("e", [0.0, 0.5, 0.8])
def test_small_swarms_fly_in_the_nonlinear_world_as_planned(e):
    """A thousandth of the swarm, so that what is left out is a millionth."""
    scenario, problem = ring(1, e), about(e)
    plan, world = solve(scenario), NonlinearWorld.of(problem, scenario.n)
    state, missed = 1e-3 * scenario.initial, []
    for k in range(problem.intervals):
        state = world.arc(state, 1e-3 * plan.controls[:, k], k)[:, -1, -1]
        missed.append(1e3 * state - plan.states[:, k + 1])
    assert np.abs(np.stack(missed)[..., :3]).max() < 1e-4
    assert np.abs(np.stack(missed)[..., 3:]).max() < 1e-6


@pytest.mark.parametrize("e", [0.1, 0.8])
def test_after_a_loss_of_thrust_craft_stay_apart(e):
    """For half an orbit from any node, looked at every 5 s of it."""
    scenario, problem = ring(1, e), about(e)
    plan = solve(scenario, requirements=Requirements(passive_safety=0.5))
    assert plan.status == SOLVED
    claim = plan.certificate.passive_safety
    (found,) = least_after_loss(
        plan.states, plan.controls, problem, 0.5, swarm_partition((scenario.n,))
    )
    look, length = problem.time_step / PARTS, np.pi / problem.mean_motion
    count, flying = int(length / look), problem.intervals * PARTS
    begin = problem.orbit.states(np.zeros(1))[0]
    free, _, _ = linear_maps(begin, look * np.arange(1, flying + count + 1), FORCE)
    free = np.concatenate([np.eye(6)[None], free])
    flown = flight(e)(scenario.initial, plan.controls)
    home = np.linalg.solve(free[flying], plan.states[:, -1].T)  # where drifts from goals began
    adrift = np.einsum("tij,jn->nti", free[flying + 1 :, :3], home)
    track = np.concatenate([positions(flown), adrift], axis=1)
    least = np.inf
    for node in range(problem.nodes):
        first = node * PARTS
        origin = np.linalg.solve(free[first], plan.states[:, node].T)
        lost = np.einsum("tij,jn->nti", free[first : first + count + 1, :3], origin)
        for craft in range(scenario.n):
            others = np.delete(track[:, first : first + count + 1], craft, axis=0)
            least = min(least, np.linalg.norm(others - lost[craft], axis=-1).min())
    assert found.bound - 1e-6 <= least < found.distance + 0.2
    assert claim.min_separation == pytest.approx(found.distance, abs=1e-3)
    assert least >= 15.0 - 1e-6


def test_where_no_plan_is_passively_safe_the_encounter_that_is_named_happens():
    """A craft that drifts on from its start meets another that drifts on from its goal."""
    scenario, problem = ring(1, 0.5), about(0.5)
    plan = solve(scenario, requirements=Requirements(passive_safety=0.5))
    assert plan.status == INFEASIBLE
    found = unavoidable_encounter(Ends(scenario.initial, scenario.goal, problem, 0.5))
    assert f"within {found.distance:g} m" in plan.message
    assert (found.node, problem.duration < found.time) == (0, True)
    begin = problem.orbit.states(np.zeros(1))[0]
    free, _, _ = linear_maps(begin, np.array([problem.duration, found.time]), FORCE)
    lost, other = found.pair
    start = np.linalg.solve(free[0], scenario.goal[other])  # where its drift would have begun
    apart = free[1] @ (scenario.initial[lost] - start)
    assert np.linalg.norm(apart[:3]) == pytest.approx(found.distance, abs=1e-6)
    assert found.distance < 15.0


@pytest.mark.parametrize("e", [0.1, 0.8])
def test_the_risk_is_kept_in_trials(e):
    """And the plan that is made without it fails by the same trials."""
    scenario, trials, asked = ring(1, e), 2000, 0.02
    errors = 0.5, 0.01
    plan = solve(scenario, requirements=Requirements(risk=RiskLimit(asked, *errors)))
    assert plan.status == SOLVED
    assert plan.certificate.risk.bound <= asked
    bare = solve(scenario)
    hits = []
    for one in (plan, bare):
        told = Errors(errors[0], errors[0] * about(e).mean_motion, errors[1])
        rng = np.random.default_rng(0)
        starts, pushes = drawn(scenario.initial, one.controls, told, trials, rng)
        planned = positions(flight(e)(scenario.initial, one.controls))
        i, j = pairs(scenario.n)
        near = np.linalg.norm(planned[i] - planned[j], axis=-1).min(axis=1) < 25
        hit = np.zeros(trials, dtype=bool)
        for a, b in zip(i[near], j[near], strict=True):
            gap = flight(e)(starts[:, a] - starts[:, b], pushes[:, a] - pushes[:, b])
            place = positions(gap)
            hit |= (np.vecdot(place, place) < 15.0**2).any(axis=1)
        hits.append(int(hit.sum()))
    lower, upper = wilson(hits[0], trials)
    assert lower <= plan.certificate.risk.bound <= 4 * upper
    assert wilson(hits[1], trials)[0] > asked


@pytest.mark.parametrize("planner", ["expert", "refiner"])
def test_about_a_circle_without_j2_plans_are_those_of_the_default_problem(planner):
    problem = Problem()
    orbit = ReferenceOrbit(R_EARTH + 500e3, 0.0, 51.6, 40.0, 30.0, 10.0, j2=False)
    assert orbit.mean_motion == pytest.approx(problem.mean_motion, rel=1e-14)
    scenario = draw("rings", 1, 10, 0, problem)
    other = replace(scenario, problem=problem.about(orbit))
    for asked in (Requirements(), Requirements(passive_safety=0.5)):
        one, same = (named_planner(planner, asked).plan([s])[0] for s in (scenario, other))
        assert one.status == same.status == SOLVED
        assert same.certificate.fuel == pytest.approx(one.certificate.fuel, rel=1e-6)
        np.testing.assert_allclose(same.states[..., :3], one.states[..., :3], atol=1e-4)
        found, expected = (p.certificate.min_separation for p in (same, one))
        assert found == pytest.approx(expected, abs=1e-4)
