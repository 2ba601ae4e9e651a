"""Ends of a scenario file as rings: the states that they stand for, and what is refused."""

import json

import numpy as np
import pytest

from pipeline.errors import InputError
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import mean_motion_at
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.rings import ring_states, secular_drift
from pipeline.plan.document import read_plan, write_plan
from pipeline.planners.named import named_planner
from pipeline.scenario.document import read_scenario, write_by_hand
from pipeline.scenario.part_documents import OrbitDocument

E = mean_motion_at(500e3)


def written(path, start, end, **fields):
    fields = {"altitude": 500e3, "initial": {"rings": start}, "goal": {"rings": end}} | fields
    return write_by_hand(path, fields)


def test_a_ring_stands_for_the_states_of_its_equations(tmp_path):
    """x = (a/2) cos θ, y = offset - a sin θ, z = (a/2) tan i cos(θ + φ), by hand for two phases."""
    ring = {"craft": 2, "first_phase_deg": 90, "size": 200, "tilt_deg": 45, "offset": 30}
    at_90 = [0, 30 - 200, 0, -100 * E, 0, -100 * E]
    at_270 = [0, 30 + 200, 0, 100 * E, 0, 100 * E]
    made = written(tmp_path / "s.json", [ring], [ring | {"cross_phase_deg": -90}])
    assert made.initial == pytest.approx(np.array([at_90, at_270]), abs=1e-12)
    # z = 100 cos(90° - 90°) is at its top, and ż = 0
    at_90[2], at_90[5] = 100, 0
    at_270[2], at_270[5] = -100, 0
    assert made.goal == pytest.approx(np.array([at_90, at_270]), abs=1e-12)


def test_craft_are_numbered_ring_after_ring_and_phases_may_be_given_one_by_one(tmp_path):
    rings = [{"phases_deg": [0, 180], "size": 100}, {"craft": 1, "size": 300}]
    made = written(tmp_path / "s.json", rings, rings)
    assert made.initial[:, 0] == pytest.approx([50, -50, 150])


def test_a_file_keeps_its_rings_and_reads_as_the_same_states(tmp_path):
    made = written(tmp_path / "s.json", [{"craft": 3, "size": 80.5}], [{"craft": 3, "size": 120}])
    kept = json.loads((tmp_path / "s.json").read_text())
    assert kept["initial"] == {"rings": [{"craft": 3, "size": 80.5}]}
    read = read_scenario(tmp_path / "s.json")
    assert (read.initial == made.initial).all() and (read.goal == made.goal).all()


def test_a_plan_holds_raw_states_and_the_reference_orbit_of_a_scenario_of_rings(tmp_path):
    where = {
        "epoch": "2026-03-01T14:00:00.25+02:00",
        "inclination_deg": 97.4,
        "raan_deg": 0.1,
        "argument_of_latitude_deg": 359.9,
    }
    ring = [{"craft": 2, "size": 100}]
    made = written(tmp_path / "s.json", ring, ring, reference=where)
    write_plan(tmp_path / "p.json", named_planner("decoupled-optimum").plan([made])[0])
    kept = json.loads((tmp_path / "p.json").read_text())["scenario"]
    assert kept["initial"] == made.initial.tolist()
    assert kept["reference"] == where | {"epoch": "2026-03-01T12:00:00.250000Z"}
    again = read_plan(tmp_path / "p.json").scenario
    assert again.reference == made.reference
    assert (again.goal == made.goal).all()
    assert again.problem == Problem()


def test_rings_about_an_orbit_are_bounded_at_both_ends(tmp_path):
    """The goal's about the reference where it is at the last node."""
    orbit = ReferenceOrbit.of_mean(
        semi_major_axis=6.9e6, eccentricity=0.005, inclination_deg=51.6, raan_deg=5.0
    )
    fields = {"altitude": None, "orbit": OrbitDocument.of(orbit).model_dump()}
    ring = {"craft": 3, "size": 250, "tilt_deg": 30, "first_phase_deg": 20}
    made = written(tmp_path / "s.json", [ring], [ring], **fields)
    problem = made.problem
    shape = 250.0, np.radians(30), np.radians([20.0, 140.0, 260.0])
    np.testing.assert_allclose(made.initial, ring_states(problem, *shape), atol=1e-9)
    later = problem.starting_at(problem.intervals)
    np.testing.assert_allclose(made.goal, ring_states(later, *shape), atol=1e-9)
    assert np.abs(made.goal - made.initial).max() > 0.1
    for states, about in ((made.initial, problem), (made.goal, later)):
        assert np.abs(secular_drift(states, about)).max() < 1e-3
    read = read_scenario(tmp_path / "s.json")
    np.testing.assert_array_equal(read.goal, made.goal)


RING = {"craft": 2, "size": 100}
TALL, FLAT = (
    {"from": 0, "to": 9, "box": {"min": [0, 0, 0], "max": [1, 1, height]}} for height in (1, 0)
)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"goal": {"rings": [RING, RING | {"tilt_deg": 95}]}}, "goal.rings[1].tilt_deg is 95"),
        ({"goal": {"rings": [RING | {"phases_deg": [1]}]}}, "goal.rings[0]: give one of craft"),
        ({"goal": {"rings": [{"size": 3}]}}, "goal.rings[0]: give one of craft"),
        (
            {"goal": {"rings": [{"phases_deg": [1], "first_phase_deg": 2, "size": 3}]}},
            "goal.rings[0]: first_phase_deg goes with craft",
        ),
        ({"goal": {"rings": [RING | {"size": -1}]}}, "goal.rings[0].size is -1"),
        ({"goal": {"rings": [RING | {"tilt": 1}]}}, "goal.rings[0].tilt is not a field"),
        ({"goal": {"rings": []}}, "goal.rings"),
        ({"goal": {"states": []}}, "goal.rings is missing; goal.states is not a field"),
        ({"goal": "ring"}, "goal is 'ring': give a list of states"),
        ({"goal": {"rings": [RING | {"craft": 3}]}}, "initial has 2 states and goal has 3"),
        ({"reference": {"epoch": "2026-03-01"}}, "reference.epoch is '2026-03-01': give date"),
        ({"reference": {"epoch": "2026-03-01T12:00:00"}}, "reference.epoch is"),
        ({"reference": {"epoch": 5}}, "reference.epoch is 5"),
        *(
            ({"reference": {"epoch": f"{day}T19:28:34Z"}}, "of a year after 1960 and before 2200")
            for day in ("1957-10-04", "9999-12-31")
        ),
        ({"reference": {"epoch": "9999-12-31T23:00:00-02:00"}}, "reference.epoch is"),
        ({"reference": {}}, "reference.epoch is missing; reference.inclination_deg is missing"),
        ({"craft": [{}, {"no_burn": [[9, 5]]}]}, "craft[1]: no_burn has 9 to 5 s"),
        ({"craft": [{}, {"radius": 1e-9}]}, "craft[1]: radius is 1e-09; expected"),
        ({"corridors": [TALL, FLAT]}, "corridors[1]: a box has min (0.0, 0.0, 0.0)"),
        ({"nodes": 2, "time_step": 0}, "nodes is 2: "),
        ({"nodes": 2, "time_step": 0}, "time_step is 0: "),
    ],
)
def test_a_wrong_field_is_named_by_its_path_and_nothing_is_written(tmp_path, fields, words):
    with pytest.raises(InputError) as caught:
        written(tmp_path / "s.json", [RING], [RING], **fields)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "s.json").exists()


@pytest.mark.parametrize("size", [1e9, 1e300])
def test_a_ring_too_large_for_its_orbit_is_named(tmp_path, size):
    orbit = OrbitDocument.of(ReferenceOrbit(6_878_137.0, 0.001, 97.4)).model_dump()
    ends = [RING], [{"craft": RING["craft"], "size": size}]
    with pytest.raises(InputError) as caught:
        written(tmp_path / "s.json", *ends, altitude=None, orbit=orbit)
    assert f"a ring has a size of {size:g} m" in str(caught.value)
