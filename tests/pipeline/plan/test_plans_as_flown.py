"""Plans as flown in files, and what is found out of them that is not so."""

import json
from dataclasses import replace

import numpy as np
import pytest
from relative import file_flown

from pipeline.errors import InputError
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import R_EARTH
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.plan.document import read_plan, write_plan
from pipeline.plan.judge import check_states
from pipeline.plan.plan import SOLVED
from pipeline.plan.recheck import recheck
from pipeline.plan.requirements import Requirements
from pipeline.planners.as_flown import AsFlown
from pipeline.planners.classical import Expert
from pipeline.planners.goal_assignment import GoalAssignment
from pipeline.scenario import draw

ORBIT = ReferenceOrbit(
    (R_EARTH + 500e3) / 0.7, 0.3, 51.6, 40.0, 30.0, 10.0, ballistic=0.03, spread=0.4
)

SCENARIO = replace(
    draw("rings", 1, 6, 0, Problem()),
    problem=replace(Problem(), max_acceleration=0.01).about(ORBIT),
    ends="any",
)


@pytest.fixture(scope="module")
def plan():
    (made,) = AsFlown(Expert()).plan([SCENARIO])
    assert made.status == SOLVED
    return made


@pytest.fixture
def written(plan, tmp_path):
    """Its file."""
    write_plan(tmp_path / "plan.json", plan)
    return tmp_path / "plan.json"


def test_what_is_read_is_what_was_written_to_the_bit(plan, written):
    read = read_plan(written)
    for name in ("states", "controls"):
        assert np.array_equal(getattr(read, name), getattr(plan, name))
    rest = ("planner", "status", "message", "certificate", "convex_solves", "timing", "as_flown")
    assert [getattr(read, name) for name in rest] == [getattr(plan, name) for name in rest]
    assert read.as_flown
    assert read.scenario.problem == SCENARIO.problem
    assert read.scenario.ends == "any"
    assert recheck(read).faults == ()
    assert recheck(read).plan.certificate == plan.certificate
    check_states(read)


def test_the_file_alone_is_enough_to_fly_it(plan, written):
    """By an integrator that knows nothing but the numbers in it, and the air."""
    document = json.loads(written.read_text())
    asked, air = document["scenario"], (ORBIT.air.base, ORBIT.air.density, ORBIT.air.scale)
    assert document["world"] == asked["orbit"]
    assert "mean_motion" not in asked
    flown = file_flown(document, 1, air)[:, :, -1]
    assert np.abs(flown[:, -1] - np.array(asked["goal"]))[:, :3].max() < 1e-5
    assert np.abs(flown - np.array(document["states"])[:, 1:])[..., :3].max() < 1e-6


def test_plans_of_linear_motion_about_the_orbit_have_no_world(tmp_path):
    (linear,) = Expert().plan([SCENARIO])
    write_plan(tmp_path / "plan.json", linear)
    assert "world" not in json.loads((tmp_path / "plan.json").read_text())
    read = read_plan(tmp_path / "plan.json")
    assert not read.as_flown
    assert recheck(read).faults == ()
    (fault, *_) = recheck(replace(read, as_flown=True)).faults
    assert fault.startswith("Misses its goal by")


def test_assignment_and_separation_at_the_nodes_come_back(tmp_path):
    planner = GoalAssignment(Expert(requirements=Requirements("nodes")))
    (plan,) = AsFlown(planner).plan([SCENARIO])
    write_plan(tmp_path / "plan.json", plan)
    read = read_plan(tmp_path / "plan.json")
    assert (read.assignment, read.separation) == (plan.assignment, "nodes")
    assert read.as_flown
    assert recheck(read).faults == ()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"eccentricity": 0.2}, "world is another orbit than the scenario's: plan again"),
        ({"ballistic": None}, "world is another orbit than the scenario's: plan again"),
        ({"j2": False}, "world is another orbit than the scenario's: plan again"),
        ({"raan_deg": "x"}, "world.raan_deg is 'x'"),
        ({"height": 5e5}, "world.height is not a field"),
        ({"semi_major_axis": None}, "world.semi_major_axis is None"),
    ],
    ids=str,
)
def test_a_world_that_is_not_the_scenarios_orbit_is_refused(written, change, words):
    document = json.loads(written.read_text())
    document["world"] |= change
    written.write_text(json.dumps(document))
    with pytest.raises(InputError, match=words) as caught:
        read_plan(written)
    assert "plan.json" in str(caught.value) and "\n" not in str(caught.value)


def test_a_world_of_a_scenario_without_an_orbit_is_refused(written):
    document = json.loads(written.read_text())
    del document["scenario"]["orbit"]
    document["scenario"]["altitude"] = 500e3
    written.write_text(json.dumps(document))
    with pytest.raises(InputError, match="world is another orbit than the scenario's"):
        read_plan(written)


def test_a_control_that_was_changed_is_found_out(plan):
    controls = plan.controls.copy()
    controls[2, 4, 1] += 1e-7
    shown = recheck(replace(plan, controls=controls))
    assert "Misses its goal by" in shown.faults[0]
    assert any("from where its controls lead" in fault for fault in shown.faults)
    with pytest.raises(InputError, match="off those that its controls lead to"):
        check_states(replace(plan, controls=controls))


def test_a_state_that_was_changed_is_found_out(plan):
    states = plan.states.copy()
    states[3, 5, 2] -= 0.25
    shown = recheck(replace(plan, states=states))
    (fault,) = shown.faults
    assert "up to 0.25 m from where its controls lead" in fault
    np.testing.assert_allclose(shown.plan.states, plan.states, atol=1e-9)
    with pytest.raises(InputError, match=r"up to 0\.25 m off those that its controls lead to"):
        check_states(replace(plan, states=states))


@pytest.mark.parametrize(
    ("field", "value"),
    [("fuel", 1e-3), ("min_separation", 300.0), ("min_separation_bound", 300.0)],
)
def test_a_false_claim_is_named_with_what_the_flight_gives(plan, field, value):
    false = replace(plan.certificate, **{field: value})
    (fault,) = recheck(replace(plan, certificate=false)).faults
    true = getattr(plan.certificate, field)
    assert fault.startswith(f"The file claims {field} {value:.6g}")
    assert f"{true:.6g}" in fault


def test_controls_beyond_all_measure_are_refused_in_a_sentence(plan):
    with pytest.raises(InputError, match=r"controls reach 1e\+200 m/s²"):
        recheck(replace(plan, controls=np.full_like(plan.controls, 1e200)))


def test_controls_that_lead_far_away_are_told_or_refused(plan):
    """A push of 1 g leads craft thousands of kilometres off."""
    pushed = replace(plan, controls=plan.controls + 10.0)
    assert any("Misses its goal by" in fault for fault in recheck(pushed).faults)
