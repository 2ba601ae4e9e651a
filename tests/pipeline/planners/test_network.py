"""Networks as planners."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.errors import InputError
from pipeline.expert import decoupled_optima
from pipeline.networks.architecture import find
from pipeline.networks.encoding import Encoding
from pipeline.networks.model import Model
from pipeline.networks.refiner.model import packaged
from pipeline.orbit.dynamics import cw_matrices
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.transfer import fly, minimum_energy
from pipeline.plan.plan import SOLVED, UNSAFE
from pipeline.plan.requirements import Requirements
from pipeline.planners.network import NetworkPlanner, check_problem
from pipeline.scenario import Scenario, draw

PROBLEM = Problem()
SCALE = (100.0, 200.0, 50.0, 0.1, 0.2, 0.05)


def least_energy_model():
    """A network whose answer is 0, measured from the minimum-energy transfer."""
    encoding = Encoding(PROBLEM, 3, "minimum-energy", "offset", SCALE, SCALE)
    found = find("ff1")
    network = found.network(found.config, encoding, 0.0)
    model = Model("ff1", found.config, "tuned", encoding, network)
    for parameter in network.parameters():
        parameter.zero_()
    return model


def planner(model=None):
    return NetworkPlanner(model or least_energy_model(), "ff1 flown")


def drawn(n, count=3):
    return [draw("rings", 2, n, k, PROBLEM) for k in range(count)]


def crossing(radius):
    """Two craft that trade places, so that their cheapest transfers mirror each other."""
    a = np.array([50.0, 0, 0, 0, -2 * PROBLEM.mean_motion * 50, 0])
    problem = replace(PROBLEM, collision_radius=radius)
    return Scenario(problem, np.stack([a, -a]), np.stack([-a, a]), name="crossing")


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_every_flown_plan_obeys_the_dynamics_and_meets_the_goal(n):
    encoding = Encoding(PROBLEM, 3, "line", "states", SCALE, SCALE)
    found = find("ff1")
    untrained = Model(
        "ff1", found.config, "paper", encoding, found.network(found.config, encoding, 0.0)
    )
    A, B = cw_matrices(PROBLEM.mean_motion, PROBLEM.time_step)
    scenarios = drawn(n)
    plans = planner(untrained).plan(scenarios)
    assert [plan.planner for plan in plans] == ["ff1 flown"] * 3
    for scenario, plan in zip(scenarios, plans, strict=True):
        after = plan.states[:, :-1] @ A.T + plan.controls @ B.T
        np.testing.assert_allclose(plan.states[:, 1:], after, atol=1e-6)
        np.testing.assert_allclose(plan.states[:, 0], scenario.initial, atol=1e-9)
        np.testing.assert_allclose(plan.states[:, -1], scenario.goal, atol=1e-6)


def test_a_trajectory_that_can_be_flown_is_flown_as_predicted():
    scenario = drawn(3, 1)[0]
    plan = planner().plan([scenario])[0]
    expected = minimum_energy(scenario.initial, scenario.goal, PROBLEM)
    np.testing.assert_allclose(plan.controls, expected, atol=1e-9)
    np.testing.assert_allclose(plan.states, fly(scenario.initial, expected, PROBLEM), atol=1e-4)


def test_a_plan_is_solved_only_where_its_separation_is_proven():
    apart = planner().plan([crossing(1e-3)])[0].certificate.min_separation
    assert planner().plan([crossing(0.9 * apart)])[0].status == SOLVED
    unsafe = planner().plan([crossing((apart + 100) / 2)])[0]  # at their ends they are 100 m apart
    assert unsafe.status == UNSAFE
    assert "craft 0 and 1" in unsafe.message


def test_a_craft_on_its_own_is_always_safe():
    plan = planner().plan(drawn(1, 1))[0]
    assert plan.status == SOLVED
    assert plan.certificate.min_separation is None


def test_the_certificate_has_the_bound_of_each_craft_s_own_optimum():
    scenarios = drawn(3)
    for scenario, plan in zip(scenarios, planner().plan(scenarios), strict=True):
        own = decoupled_optima(scenario.initial, scenario.goal, PROBLEM)
        bound = np.abs(own.controls).sum()
        assert plan.certificate.fuel_lower_bound == pytest.approx(bound, rel=1e-6)
        assert plan.certificate.fuel == pytest.approx(np.abs(plan.controls).sum())


def test_no_scenarios_make_no_plans():
    assert planner().plan([]) == []


def untrained(arch):
    encoding, found = Encoding(PROBLEM, 3, "line", "states", SCALE, SCALE), find(arch)
    return Model(arch, found.config, "t", encoding, found.network(found.config, encoding, 0.0))


@pytest.mark.parametrize(
    ("arch", "change"),
    [
        ("lstm1", {"nodes": 16}),
        ("lstm1", {"time_step": 90.0}),
        ("ff1", {"time_step": 90.0}),
        ("ff1", {"mean_motion": 1.2e-3}),
    ],
    ids=str,
)
def test_another_grid_or_orbit_is_flown_where_the_weights_fit(arch, change):
    problem = replace(PROBLEM, **change)
    scenario = draw("rings", 2, 3, 0, problem)
    plan = planner(untrained(arch)).plan([scenario])[0]
    A, B = cw_matrices(problem.mean_motion, problem.time_step)
    states = [scenario.initial]
    for t in range(problem.intervals):
        states.append(states[-1] @ A.T + plan.controls[:, t] @ B.T)
    np.testing.assert_allclose(plan.states, np.stack(states, axis=1), atol=1e-6)
    np.testing.assert_allclose(states[-1], scenario.goal, atol=1e-6)


def test_another_number_of_nodes_is_refused_where_the_weights_do_not_fit():
    scenario = draw("rings", 2, 3, 0, replace(PROBLEM, nodes=12))
    with pytest.raises(InputError, match="do not fit nodes 12"):
        planner(untrained("ff1")).plan([scenario])


@pytest.mark.parametrize(
    "change", [{"nodes": 12}, {"time_step": 100.0}, {"mean_motion": 1.2e-3}], ids=str
)
def test_experiments_refuse_a_scenario_of_another_orbit_or_time_grid_by_name(change):
    with pytest.raises(InputError, match=f"data has {next(iter(change))} "):
        check_problem(least_energy_model(), replace(PROBLEM, **change), "data")


def test_a_plan_judged_at_the_nodes_alone_is_solved_where_craft_pass_between_them():
    """Two craft that change places meet half way, between the nodes of an even grid."""
    problem = replace(PROBLEM, nodes=12)
    encoding = Encoding(problem, 2, "minimum-energy", "offset", SCALE, SCALE)
    found = find("ff1")
    model = Model("ff1", found.config, "t", encoding, found.network(found.config, encoding, 0.0))
    for parameter in model.network.parameters():
        parameter.zero_()
    one = crossing(1e-3)
    apart = planner(model).plan([replace(one, problem=problem)])[0]
    gap = np.linalg.norm(apart.states[0, :, :3] - apart.states[1, :, :3], axis=-1).min()
    radius = (gap + apart.certificate.min_separation) / 2
    assert radius < gap
    between = replace(one, problem=replace(problem, collision_radius=float(radius)))
    assert planner(model).plan([between])[0].status == UNSAFE
    at_nodes = replace(planner(model), requirements=Requirements("nodes"))
    assert at_nodes.plan([between])[0].status == SOLVED


def test_an_orbit_written_with_fewer_digits_is_still_the_same():
    scenario = drawn(2, 1)[0]
    rounded = replace(PROBLEM, mean_motion=float(f"{PROBLEM.mean_motion:.8g}"))
    assert planner().plan([replace(scenario, problem=rounded)])


@pytest.mark.parametrize("n", [1, 3, 8])
def test_answered_controls_are_flown_and_meet_the_goal_for_any_number_of_craft(gentle, n):
    model = untrained(gentle)
    A, B = cw_matrices(PROBLEM.mean_motion, PROBLEM.time_step)
    scenarios = drawn(n)
    ends = [np.stack([getattr(s, end) for s in scenarios]) for end in ("initial", "goal")]
    answer, states = model.answer(*ends, PROBLEM.collision_radius), model.predict(*ends)
    assert model.answers == "controls"
    for k, plan in enumerate(planner(model).plan(scenarios)):
        after = plan.states[:, :-1] @ A.T + plan.controls @ B.T
        np.testing.assert_allclose(plan.states[:, 1:], after, atol=1e-6)
        np.testing.assert_allclose(plan.states[:, -1], scenarios[k].goal, atol=1e-6)
        # The network meets it but for float32's rounding, so there is next to nothing to correct.
        np.testing.assert_allclose(plan.controls, answer[k], atol=1e-5 * np.abs(answer).max())
        np.testing.assert_allclose(plan.states, states[k], atol=1e-2)


def test_controls_that_miss_the_goal_get_the_least_energy_that_meets_it(gentle, monkeypatch):
    scenario = drawn(3, 1)[0]
    idle = np.zeros((1, 3, PROBLEM.intervals, 3))
    monkeypatch.setattr(Model, "answer", lambda *_: idle)
    plan = planner(untrained(gentle)).plan([scenario])[0]
    expected = minimum_energy(scenario.initial, scenario.goal, PROBLEM)
    np.testing.assert_allclose(plan.controls, expected, atol=1e-12)


def test_a_network_is_told_the_collision_radius_of_the_scenario(gentle):
    model = untrained(gentle)

    def controls(radius):
        scenario = replace(drawn(3, 1)[0], problem=replace(PROBLEM, collision_radius=radius))
        return planner(model).plan([scenario])[0].controls

    assert np.array_equal(controls(10.0), controls(10.0))
    assert np.abs(controls(10.0) - controls(20.0)).max() > 1e-9


def test_a_refiner_is_asked_about_any_orbit_and_grid():
    other = Problem(nodes=7, time_step=60.0).about(ReferenceOrbit(8e6, 0.1))
    check_problem(packaged(), other, "data")


def test_swarms_of_several_sizes_are_refused_as_networks_answer_in_one_array():
    sizes = [draw("rings", 2, n, 0, PROBLEM) for n in (2, 4)]
    with pytest.raises(InputError, match=r"scenarios have \[2, 4\] craft; expected one size"):
        planner().plan(sizes)
