"""Scenarios with a reference orbit of their own, and ends that may drift: files and checks."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from relative import linear_maps, pull

from pipeline.errors import InputError
from pipeline.orbit.dynamics import model_error
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import MU_EARTH, R_EARTH
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.rings import pro_states
from pipeline.scenario import Scenario, diagnostics, draw
from pipeline.scenario.document import read_checked, read_scenario, write_scenario
from pipeline.scenario.validation import check

MATCHED = "energy-matched"


def about(e, **changed):
    return ReferenceOrbit((R_EARTH + 500e3) / (1 - e), e, 51.6, 40.0, 30.0, 10.0, **changed)


ORBIT = about(0.3, ballistic=0.02, spread=0.25)


def swarm(orbit):
    """Rings that close about a circle, and drift about other orbits."""
    drawn = draw("rings", 1, 4, 0, Problem())
    return replace(drawn, problem=replace(Problem(), max_acceleration=0.01).about(orbit))


@pytest.fixture
def written(tmp_path):
    """A scenario with an orbit and ends that may drift, in a file."""
    path = tmp_path / "scenario.json"
    write_scenario(path, replace(swarm(ORBIT), ends="any"))
    return path


def change(path, **fields):
    """The file with other fields, or of its orbit."""
    document = json.loads(path.read_text())
    orbit = fields.pop("orbit", {})
    document |= fields
    document["orbit"] = orbit and document["orbit"] | orbit
    path.write_text(json.dumps(document))
    return path


def test_a_scenario_with_an_orbit_survives_the_file_to_the_bit(written):
    read, asked = read_scenario(written), swarm(ORBIT)
    assert read.problem == asked.problem
    assert read.problem.orbit == ORBIT
    assert read.ends == "any"
    assert np.array_equal(read.initial, asked.initial)
    assert np.array_equal(read.goal, asked.goal)
    document = json.loads(written.read_text())
    assert "mean_motion" not in document and "altitude" not in document
    assert document["orbit"]["eccentricity"] == 0.3
    write_scenario(written, swarm(replace(ORBIT, ballistic=None, spread=0.0)))
    assert read_scenario(written).problem.orbit.ballistic is None
    assert "ends" not in json.loads(written.read_text())


def test_what_an_orbit_leaves_out_is_a_circle_in_the_equator_of_an_oblate_earth(written):
    document = json.loads(written.read_text()) | {"orbit": {"semi_major_axis": 7e6}}
    written.write_text(json.dumps(document))
    assert read_scenario(written).problem.orbit == ReferenceOrbit(7e6)


@pytest.mark.parametrize(
    "fields", [{"mean_motion": 0.0011}, {"altitude": 500e3}, {"orbit": None}], ids=str
)
def test_one_of_mean_motion_altitude_and_orbit_is_given(written, fields):
    with pytest.raises(InputError, match=r"give one of mean_motion \(rad/s\), altitude \(m\) and"):
        read_scenario(change(written, **{"orbit": {"j2": True}} | fields))


@pytest.mark.parametrize(
    ("orbit", "words"),
    [
        ({"semi_major_axis": -1}, "orbit.semi_major_axis is -1"),
        ({"semi_major_axis": 1e6}, "orbit: semi_major_axis is 1e\\+06 m and eccentricity 0.3, a"),
        ({"semi_major_axis": float("nan")}, "orbit.semi_major_axis is nan"),
        ({"eccentricity": 0.9}, "orbit.eccentricity is 0.9"),
        ({"eccentricity": "0.1"}, "orbit.eccentricity is '0.1'"),
        ({"inclination_deg": 200}, "orbit.inclination_deg is 200"),
        ({"raan_deg": "x"}, "orbit.raan_deg is 'x'"),
        ({"argument_of_perigee_deg": 400}, "orbit: argument_of_perigee_deg is 400; expected"),
        ({"argument_of_latitude_deg": None}, "orbit.argument_of_latitude_deg is None"),
        ({"j2": "yes"}, "orbit.j2 is 'yes'"),
        ({"j2": 1}, "orbit.j2 is 1"),
        ({"ballistic": 0}, "orbit.ballistic is 0"),
        ({"ballistic": 200}, "orbit: ballistic is 200; expected"),
        ({"spread": 2}, "orbit: spread is 2; expected a number from 0 to 1"),
        ({"start": 0}, "orbit.start is not a field of this schema"),
        ({"inclination": 10}, "orbit.inclination is not a field.*did you mean inclination_deg"),
        (
            {"semi_major_axis": R_EARTH + 120e3, "eccentricity": 0},
            "orbit: the reference orbit is 120 km high.*leave drag out",
        ),
        (3, "orbit is 3"),
    ],
)
def test_a_wrong_field_of_an_orbit_is_named_by_its_path(written, orbit, words):
    if isinstance(orbit, dict):
        change(written, orbit=orbit)
    else:
        written.write_text(json.dumps(json.loads(written.read_text()) | {"orbit": orbit}))
    with pytest.raises(InputError, match=words) as caught:
        read_scenario(written)
    assert "scenario.json" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("ends", ["none", None, True])
def test_ends_are_one_of_two_words(written, ends):
    with pytest.raises(InputError, match="ends is"):
        read_scenario(change(written, orbit={"j2": True}, ends=ends))


def test_an_orbit_at_which_a_plan_begins_later_is_not_written_as_if_it_did_not(tmp_path):
    scenario = swarm(ORBIT)
    later = replace(scenario, problem=scenario.problem.starting_at(3))
    with pytest.raises(InputError, match=r"start is 360 s after its epoch; expected elements at"):
        write_scenario(tmp_path / "s.json", later)
    assert not (tmp_path / "s.json").exists()


def test_ends_that_drift_are_refused_by_default_and_accepted_where_they_may(written):
    assert read_checked(written).ends == "any"
    document = json.loads(written.read_text())
    del document["ends"]
    written.write_text(json.dumps(document))
    with pytest.raises(
        InputError, match=r"scenario\.json: initial\[\d\] drifts [+-][\d.e+]+ m along-track an"
    ):
        read_checked(written)
    assert read_checked(written, allow_drift=True).ends == "passive"


@pytest.mark.parametrize("orbit", [None, about(0.3)], ids=["circle", "ellipse"])
def test_what_may_drift_is_said_to_and_nothing_is_to_be_mended(orbit):
    scenario = swarm(about(0.3))
    if orbit is None:
        states = pro_states(100.0, 0.3, np.arange(3.0), 0.0, Problem().mean_motion)
        states[1, 4] += 0.01
        scenario = Scenario(Problem(), states, states)
    for ends, fine in (("passive", False), ("any", True)):
        found = [one for one in diagnostics(replace(scenario, ends=ends)) if one.rule == MATCHED]
        assert [one.fine for one in found] == [fine, fine]
        assert ["to mend it" in str(one) for one in found] == [not fine, not fine]
        assert all("drift" in one.text for one in found)


def along_track(problem, first):
    """What maps a state to its drift along-track, m an orbit, by an integrator, some s after.

    The slope of along-track positions averaged over each of three revolutions.
    """
    orbit, looks = problem.orbit, 180
    begin = orbit.states(np.array([0.0, first]))[-1]
    period = 2 * np.pi * (orbit.mean_elements.semi_major_axis**3 / MU_EARTH) ** 0.5
    times = period * (1 + np.arange(3 * looks)) / looks
    maps, _, _ = linear_maps(begin, times, partial(pull, j2=orbit.j2))
    average = maps[:, 1].reshape(3, looks, 6).mean(axis=1)
    return (average[2] - average[0]) / 2


@pytest.mark.parametrize("j2", [False, True], ids=["two bodies", "J2"])
@pytest.mark.parametrize("e", [0.0, 0.01, 0.8])
def test_the_drift_of_an_orbit_is_an_integrators_and_the_vy_that_is_named_stops_it(e, j2):
    scenario = swarm(about(e, j2=j2))
    problem = scenario.problem
    if e == 0.0:  # where rings close
        scenario = replace(scenario, initial=scenario.initial + 1e-3 * np.eye(6)[4])
    found = {one.end: one for one in diagnostics(scenario) if one.rule == MATCHED}
    ends = {"initial": scenario.initial.copy(), "goal": scenario.goal.copy()}
    for end, states in ends.items():
        slope = along_track(problem, problem.duration if end == "goal" else 0.0)
        for case in found[end].cases:
            (k,) = case.craft
            before = slope @ states[k]
            told = case.numbers["drift_per_orbit"]
            assert told == pytest.approx(before, rel=0.01, abs=0.15)
            assert f"drifts {told:+.4g} m along-track an orbit" in case.text
            states[k, 4] = float(f"{case.numbers['vy_wanted']:.9g}")
            # But for terms of second order in the distance, 3π d²/a, and in J2
            assert abs(slope @ states[k]) < 0.15 + 5e-3 * abs(before)
    mended = replace(scenario, **ends)
    check(mended)
    assert all(one.fine for one in diagnostics(mended) if one.rule == MATCHED)
    if e > 0:
        with pytest.raises(
            InputError, match=r"expected 0 within .* m \(energy matching\): set vy to"
        ):
            check(scenario)


def test_the_error_of_the_linear_model_about_an_orbit_leaves_out_what_is_in_it():
    about = ReferenceOrbit(6886536.686, 0.0001264, 97.4453)
    swarm = draw("rings", 0, 4, 0, Problem())
    on_circle, in_orbit = (
        model_error(swarm.initial, problem.dynamics, problem.duration)
        for problem in (swarm.problem, swarm.problem.about(about))
    )
    assert on_circle.oblateness > 0
    assert in_orbit.total == pytest.approx(on_circle.curvature, rel=0.05)
