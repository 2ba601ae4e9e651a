"""The judge of plans: it passes what is sound and finds what is planted, with truth by hand."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from judge import Case, closest_approaches, fly, judge_plan, least_fuel
from scipy.integrate import solve_ivp

E, STEP, NODES = 1.1e-3, 120.0, 5
FREE = {"mean_motion": 1e-12, "time_step": 10.0, "nodes": 5, "collision_radius": 15.0}
"""As good as free space, where motion is easy to work out by hand."""


def integrated(start, controls, samples, rate=E, step=STEP):
    """States of one craft by an integrator, so many an interval, the very first left out."""

    def motion(_, s, u):
        x, _, z, vx, vy, vz = s
        ax, ay = 3 * rate**2 * x + 2 * rate * vy + u[0], -2 * rate * vx + u[1]
        return [vx, vy, vz, ax, ay, -(rate**2) * z + u[2]]

    track = []
    for held in controls:
        found = solve_ivp(
            motion, (0, step), start, "DOP853", args=(held,), rtol=1e-13, atol=1e-13,
            t_eval=np.linspace(0, step, samples + 1)[1:], first_step=step / 50,
        )  # fmt: skip
        start = found.y[:, -1]
        track.append(found.y.T)
    return np.concatenate(track)


@pytest.fixture(scope="module")
def sound():
    """A scenario and a plan with a certificate, all of it by the integrator and by hand."""
    rng = np.random.default_rng(0)
    initial = np.array([[0, 0, 0, 0.1, 0, 0], [100.0, 50, -30, 0, -0.3, 0.1]])
    controls = rng.uniform(-1e-3, 1e-3, (2, NODES - 1, 3))
    controls[0, 0, 0] = 1e-3
    tracks = np.stack([integrated(s, u, 6000) for s, u in zip(initial, controls, strict=True)])
    states = np.concatenate([initial[:, None], tracks[:, 5999::6000]], axis=1)
    apart = np.linalg.norm(tracks[0, :, :3] - tracks[1, :, :3], axis=1)
    scenario = {
        "altitude": (3.986004418e14 / E**2) ** (1 / 3) - 6378137.0,
        "time_step": STEP,
        "nodes": NODES,
        "collision_radius": 15.0,
        "max_acceleration": 1e-3,
        "initial": initial.tolist(),
        "goal": states[:, -1].tolist(),
    }
    certificate = {
        "fuel": np.abs(controls).sum(),
        "delta_v": np.abs(controls).sum() * STEP,
        "node_collisions": 0,
        "min_separation": apart.min(),
        "min_separation_bound": apart.min() - 1e-3,
        "min_separation_pair": [0, 1],
        "min_separation_time": (apart.argmin() + 1) * STEP / 6000,
        "goal_error": 0.0,
        "dynamics_error": 0.0,
    }
    times = [0.0, 120.0, 240.0, 360.0, 480.0]
    plan = {"states": states, "controls": controls, "times": times, "certificate": certificate}
    return scenario, plan


def test_the_judge_imports_nothing_of_ours():
    code = (
        "import sys, judge\n"
        "assert not {'pipeline', 'registry', 'cli'} & set(sys.modules)\n"
        "text = ''.join(p.read_text() for p in __import__('pathlib').Path(judge.__file__)"
        ".parent.glob('*.py'))\n"
        "assert len(text) > 5000 and not any('import ' + x in text or 'from ' + x in text"
        " for x in ('pipeline', 'registry', 'cli'))"
    )
    support = Path(__file__).parents[1] / "support"
    subprocess.run([sys.executable, "-c", code], cwd=support, check=True, env={})


def test_a_sound_plan_has_nothing_wrong(sound):
    report = judge_plan(*sound)
    assert report.wrong == ()
    said = sound[1]["certificate"]
    assert report.fuel == pytest.approx(said["fuel"], rel=1e-12)
    assert report.min_separation == pytest.approx(said["min_separation"], abs=1e-3)
    assert 0 < report.fuel_lower_bound < report.fuel


def changed(document, name, value):
    return {**document, name: value}


@pytest.mark.parametrize("component", range(6))
def test_a_missed_goal_is_found_in_every_component(sound, component):
    scenario, plan = sound
    goal = np.array(scenario["goal"])
    goal[1, component] += 1e-3
    report = judge_plan(changed(scenario, "goal", goal), plan)
    assert "misses the goal" in report.faults[0]
    assert "0.001 m/s" in report.faults[0] if component >= 3 else "0.001 m" in report.faults[0]


def test_thrust_over_the_limit_is_found(sound):
    scenario, plan = sound
    report = judge_plan(changed(scenario, "max_acceleration", 0.99999e-3), plan)
    assert "uses 0.001 m/s² of 0.00099999 m/s²" in report.faults


def test_swapped_craft_are_found_in_states_in_controls_and_in_both(sound):
    scenario, plan = sound
    for names in (["states"], ["controls"], ["states", "controls"]):
        swapped = {**plan, **{name: plan[name][::-1] for name in names}}
        assert any("from what is flown" in what for what in judge_plan(scenario, swapped).wrong)
    both = {**plan, "states": plan["states"][::-1], "controls": plan["controls"][::-1]}
    assert any("misses the goal" in what for what in judge_plan(scenario, both).faults)


@pytest.mark.parametrize("by", [[1e-4, 0, 0, 0, 0, 0], [0, 0, 0, 0, 1e-7, 0]])
def test_states_that_the_controls_do_not_fly_are_found(sound, by):
    scenario, plan = sound
    states = plan["states"].copy()
    states[0, 2] += by
    report = judge_plan(scenario, changed(plan, "states", states))
    assert report.faults == ()
    assert any("from what is flown" in what for what in report.false_claims)


@pytest.mark.parametrize(
    ("name", "by"),
    [
        ("fuel", 1e-7),
        ("delta_v", -1e-6),
        ("node_collisions", 1),
        ("min_separation", 1e-3),
        ("min_separation", -1e-3),
        ("min_separation_bound", 2e-3),
        ("goal_error", 1e-3),
        ("dynamics_error", 1e-3),
        ("min_separation_time", 5.0),
    ],
)
def test_a_false_claim_is_found(sound, name, by):
    scenario, plan = sound
    said = changed(plan["certificate"], name, plan["certificate"][name] + by)
    report = judge_plan(scenario, changed(plan, "certificate", said))
    assert report.faults == ()
    assert len(report.false_claims) >= 1


def test_claims_about_the_bound_are_held_against_it(sound):
    scenario, plan = sound
    report = judge_plan(scenario, plan)
    gap = report.fuel / report.fuel_lower_bound - 1
    for bound, said, wrong in (
        (report.fuel_lower_bound, gap, 0),
        (report.fuel_lower_bound * 1.00001, gap, 1),
        (report.fuel_lower_bound * 0.99999, gap, 1),
        (report.fuel_lower_bound, gap - 1e-5, 1),
        (None, gap, 1),
    ):
        claims = {"fuel_lower_bound": bound, "optimality_gap": said}
        found = judge_plan(scenario, changed(plan, "certificate", claims))
        assert len(found.false_claims) == wrong


def test_arrays_of_another_size_or_without_numbers_cannot_be_judged(sound):
    scenario, plan = sound
    with pytest.raises(ValueError, match=r"states are \(2, 4, 6\)"):
        judge_plan(scenario, changed(plan, "states", plan["states"][:, 1:]))
    with pytest.raises(ValueError, match="not finite"):
        judge_plan(scenario, changed(plan, "controls", plan["controls"] * np.nan))


def passing(miss, speed, moment):
    """A craft at rest, and one that passes it at a speed and a moment, drifting."""
    initial = np.array([[0.0] * 6, [-speed * moment, miss, 0, speed, 0, 0]])
    controls = np.zeros((2, 4, 3))
    states = fly(Case.of(FREE), initial, controls)
    scenario = {**FREE, "initial": initial, "goal": states[:, -1]}
    return scenario, {"states": states, "controls": controls}


@given(
    miss=st.floats(0, 14.9), speed=st.floats(4, 5e3), moment=st.floats(0, 40), spare=st.floats(0, 1)
)
def test_no_pass_slips_through_however_fast_and_whenever_it_is(miss, speed, moment, spare):
    scenario, plan = passing(miss, speed, moment)
    scenario["collision_radius"] = miss + 1e-3 + spare
    report = judge_plan(scenario, plan)
    assert report.min_separation == pytest.approx(miss, abs=1e-3)
    assert report.pair_conflicts == 1
    assert any("comes" in what for what in report.faults)
    scenario["collision_radius"] = miss * 0.999 - 1e-3
    assert judge_plan(scenario, plan).pair_conflicts == 0


def test_a_pass_between_nodes_is_a_fault_unless_the_nodes_alone_count():
    scenario, plan = passing(miss=3.0, speed=10.0, moment=15.0)
    report = judge_plan(scenario, plan)
    assert (report.node_collisions, report.pair_conflicts) == (0, 1)
    assert report.faults == ("comes as close as 3 m between nodes",)
    assert judge_plan(scenario, plan, at_nodes=True).faults == ()
    at_a_node = judge_plan(*passing(miss=3.0, speed=10.0, moment=20.0), at_nodes=True)
    assert (at_a_node.node_collisions, at_a_node.faults) == (1, ("comes within 15 m at a node",))


@pytest.mark.parametrize(("step", "nodes"), [(120.0, 5), (3000.0, 3)])
def test_the_closest_approach_of_every_pair_is_the_integrator_s(step, nodes):
    """Steps of half an orbit too, where a pair comes close several times between two nodes."""
    rng = np.random.default_rng(3)
    initial = rng.normal(size=(4, 6)) * np.repeat([100.0, 0.1], 3)
    controls = 1e-5 * rng.normal(size=(4, nodes - 1, 3))
    problem = Case(E, step, nodes, 15.0)
    found = closest_approaches(problem, fly(problem, initial, controls), controls)
    tracks = [integrated(s, u, 20000, step=step) for s, u in zip(initial, controls, strict=True)]
    for i, j, low, high in zip(found.first, found.second, found.low, found.high, strict=True):
        apart = np.linalg.norm((tracks[i] - tracks[j])[:, :3], axis=1)
        apart = min(apart.min(), np.linalg.norm((initial[i] - initial[j])[:3]))
        assert low <= apart + 1e-6
        assert apart == pytest.approx(high, abs=2e-3)
        assert high - low < 1e-5 * max(high, 1)


def test_the_bound_is_that_of_a_shift_in_free_space():
    """A push in the first interval and one back in the last are the cheapest, worth 3 h² each."""
    there = np.array([[30.0, 0, -60, 0, 0, 0]])
    bound = least_fuel(Case.of(FREE), np.zeros((1, 6)), there)
    assert bound.proven == pytest.approx([2 * 90 / 300.0], rel=1e-7)
    assert bound.attained == pytest.approx(bound.proven, rel=1e-7)


def test_a_limit_makes_the_bound_dearer_and_then_infinite():
    """Held to 0.1 m/s², a shift of 35 m takes half a push in the second interval, worth 1 h²."""
    limited = Case.of({**FREE, "max_acceleration": 0.1})
    shifts = np.zeros((3, 6))
    shifts[:, 1] = 29.9, 35.0, 40.1
    bound = least_fuel(limited, np.zeros((3, 6)), shifts)
    assert bound.proven == pytest.approx([2 * 0.299 / 3, 0.3, np.inf], rel=1e-6)


def test_fuel_below_the_bound_is_found():
    controls = np.zeros((1, 4, 3))
    controls[0, 0, 0], controls[0, 3, 0] = 0.1 - 1e-6, -0.1 + 1e-6
    scenario = {**FREE, "initial": np.zeros((1, 6)), "goal": [[30.0, 0, 0, 0, 0, 0]]}
    states = fly(Case.of(FREE), np.zeros((1, 6)), controls)
    report = judge_plan(scenario, {"states": states, "controls": controls})
    assert any("where none burns less than 0.2" in what for what in report.faults)
