"""Scenarios from inertial states: plans handed over and back, and states by brahe."""

import json
import os
from dataclasses import replace
from datetime import UTC, datetime
from threading import Thread

import brahe
import numpy as np
import pytest
from by_brahe import flown_by_brahe

import prolearn
from pipeline.errors import InputError
from pipeline.export.messages import write_ephemerides
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import MU_EARTH, Reference
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.rings import pro_states
from pipeline.scenario import Scenario
from pipeline.scenario.document import read_scenario, write_scenario
from pipeline.scenario.inertial import (
    ELEMENTS,
    KILOMETRES,
    METRES,
    read_inertial,
    scenario_from_inertial,
)

EPOCH = datetime(2026, 3, 1, 23, 55, 0, 250000, tzinfo=UTC)
RADIANS = brahe.AngleFormat.RADIANS
ORBITS = {
    "low": ReferenceOrbit(6.878e6, 0.001, 97.4, 40.0, 90.0, 350.0),
    "eccentric": ReferenceOrbit(2.6e7, 0.7, 63.4, 300.0, 270.0, 200.0),
    "with drag": ReferenceOrbit(6.778e6, 0.002, 51.6, 10.0, 20.0, 30.0, ballistic=0.01),
}


def states(seed, n, size):
    """States with a craft at the origin and others about it."""
    rng = np.random.default_rng(seed)
    found = rng.uniform(-1, 1, (n, 6)) * np.repeat([size, size * 1e-3], 3)
    found[0] = 0
    return found


@pytest.fixture(scope="module", params=ORBITS)
def handed_over(request, tmp_path_factory):
    """A scenario, and the folder with the ephemerides of its plan as flown.

    The first craft stays at the origin, so that its ephemeris is that of the reference.
    """
    orbit = ORBITS[request.param]
    where = Reference(EPOCH, orbit.inclination_deg, orbit.raan_deg, orbit.argument_of_latitude_deg)
    problem = Problem(time_step=100 / 3, nodes=8, collision_radius=1.0).about(orbit)
    ends = states(1, 3, 400.0), states(2, 3, 400.0)
    scenario = Scenario(problem, *ends, reference=where, ends="any")
    plan = prolearn.plan(scenario, "decoupled-optimum", world=True)
    assert plan.as_flown and np.abs(plan.controls[0]).max() < 1e-12
    folder = tmp_path_factory.mktemp("oem")
    write_ephemerides(plan, folder, "p")
    # Epochs are whole microseconds, and the last node is at none: thrust makes up for it
    return scenario, folder, 1e-8 + 1e-6 * np.abs(plan.controls).max()


def assert_same(made, scenario, velocity):
    for end in ("initial", "goal"):
        there, here = getattr(scenario, end), getattr(made, end)
        assert here[:, :3] == pytest.approx(there[:, :3], abs=1e-5)
        assert here[:, 3:] == pytest.approx(there[:, 3:], abs=velocity)
    ours, wanted = made.problem.orbit, scenario.problem.orbit
    for name in ELEMENTS:
        assert getattr(ours, name) == pytest.approx(getattr(wanted, name), rel=1e-6)
    assert (ours.j2, ours.ballistic) == (wanted.j2, wanted.ballistic)
    assert made.reference.epoch == EPOCH
    assert made.reference.raan_deg == ours.raan_deg


def test_a_plan_as_flown_comes_back_from_its_ephemerides(handed_over, tmp_path):
    scenario, folder, velocity = handed_over
    orbit = scenario.problem.orbit
    row = ",".join(repr(float(getattr(orbit, name))) for name in ELEMENTS)
    (tmp_path / "chief.csv").write_text(f"{','.join(ELEMENTS)}\n{row}\n")
    given = read_inertial(folder)
    grid = Problem(time_step=100 / 3, nodes=8, collision_radius=1.0)
    for chief in (folder / "craft-0.oem", tmp_path / "chief.csv"):
        made = scenario_from_inertial(
            given, given, grid, chief=read_inertial(chief), ballistic=orbit.ballistic
        )
        assert_same(made, scenario, velocity)
        assert made.ends == "any"
        write_scenario(tmp_path / "s.json", made)
        assert_same(read_scenario(tmp_path / "s.json"), scenario, velocity)


def test_without_a_chief_the_reference_is_the_mean_of_the_craft(handed_over):
    scenario, folder, _ = handed_over
    given = read_inertial(folder)
    made = scenario_from_inertial(given, given, Problem(time_step=100 / 3, nodes=8))
    assert made.initial.mean(axis=0) == pytest.approx(np.zeros(6), abs=1e-7)
    apart = scenario.initial - scenario.initial.mean(axis=0)
    assert made.initial[:, :3] == pytest.approx(apart[:, :3], abs=0.1)  # axes turn by 1e-4


def test_a_later_node_is_a_first_node_too(handed_over):
    _, folder, _ = handed_over
    given = read_inertial(folder)
    middle = EPOCH.replace(minute=56, second=0)  # no node: 60 s on
    made = scenario_from_inertial(given, given, Problem(time_step=20.0, nodes=6), epoch=middle)
    assert made.reference.epoch == middle
    with pytest.raises(InputError, match=r"craft-0\.oem has states from .*; expected one at"):
        scenario_from_inertial(given, given, Problem(time_step=40.0, nodes=6), epoch=middle)


def by_brahe(a, e, i, raan, perigee, latitude, seconds=0.0):
    """The two-body state so many seconds later, angles in degrees; velocity by our μ."""
    i, raan, perigee, latitude = np.radians([i, raan, perigee, latitude])
    mean = brahe.anomaly_true_to_mean(latitude - perigee, e, angle_format=RADIANS)
    mean += np.sqrt(MU_EARTH / a**3) * seconds
    state = brahe.state_koe_to_eci(np.array([a, e, i, raan, perigee, mean]), RADIANS)
    return state * np.repeat([1.0, np.sqrt(MU_EARTH / brahe.GM_EARTH)], 3)


CHIEF = (7.2e6, 0.05, 51.6, 30.0, 40.0, 10.0)
CRAFT = [(7.2e6, 0.05001, 51.6, 30.0, 40.0, 10.001), (7.2e6, 0.05, 51.602, 29.999, 40.1, 9.998)]


def write_csv(path, columns, rows):
    lines = [
        ",".join(["craft", *columns]),
        *(f"c{k}," + ",".join(map(repr, row)) for k, row in enumerate(rows)),
    ]
    path.write_text("\n".join(["# by brahe", *lines]) + "\n")
    return read_inertial(path)


def test_tables_in_every_form_give_the_relative_states_of_brahe(tmp_path):
    problem = Problem(time_step=60.0, nodes=11)
    first = [by_brahe(*one) for one in CRAFT]
    last = [by_brahe(*one, seconds=600.0) for one in reversed(CRAFT)]  # each where the other is
    chief = write_csv(tmp_path / "chief.csv", ELEMENTS, [CHIEF])
    goal = write_csv(tmp_path / "goal.csv", METRES, [one.tolist() for one in last])
    listed = [dict(zip(METRES, one.tolist(), strict=True)) for one in first]
    (tmp_path / "first.json").write_text(json.dumps(listed))
    forms = [
        write_csv(tmp_path / "m.csv", METRES, [one.tolist() for one in first]),
        write_csv(tmp_path / "km.csv", KILOMETRES, [(one / 1e3).tolist() for one in first]),
        write_csv(tmp_path / "e.csv", ELEMENTS, CRAFT),
        read_inertial(tmp_path / "first.json"),
    ]
    for initial in forms:
        made = scenario_from_inertial(initial, goal, problem, chief=chief, j2=False)
        for ours, craft, time in ((made.initial, first, 0.0), (made.goal, last, 600.0)):
            origin = by_brahe(*CHIEF, seconds=time)
            wanted = np.array([brahe.state_eci_to_rtn(origin, one) for one in craft])
            assert ours[:, :3] == pytest.approx(wanted[:, :3], abs=1e-5)
            assert ours[:, 3:] == pytest.approx(wanted[:, 3:], abs=1e-7)
        assert made.reference is None
    timed = scenario_from_inertial(forms[0], goal, problem, chief=chief, epoch=EPOCH, j2=False)
    assert timed.reference.epoch == EPOCH


def test_with_j2_goals_are_relative_to_where_brahe_flies_the_reference(tmp_path):
    both = np.concatenate([by_brahe(*CHIEF), by_brahe(*CRAFT[1])])
    flown = {
        time: flown_by_brahe(both, np.zeros((1, 3)), (True, None), (0.0, 0.0), time)
        for time in (599.0, 600.0, 601.0)
    }
    seen = {
        time: brahe.rotation_rtn_to_eci(two[:6]).T @ (two[6:9] - two[:3])
        for time, two in flown.items()
    }
    chief = write_csv(tmp_path / "chief.csv", ELEMENTS, [CHIEF])
    initial = write_csv(tmp_path / "a.csv", METRES, [both[6:].tolist()])
    goal = write_csv(tmp_path / "b.csv", METRES, [flown[600.0][6:].tolist()])
    made = scenario_from_inertial(initial, goal, Problem(time_step=60.0, nodes=11), chief=chief)
    assert made.goal[0, :3] == pytest.approx(seen[600.0], abs=1e-4)
    moving = (seen[601.0] - seen[599.0]) / 2  # as the turning frame sees it
    assert made.goal[0, 3:] == pytest.approx(moving, abs=1e-5)


def test_craft_that_do_not_drift_are_on_passive_ends(tmp_path):
    orbit = ReferenceOrbit(7e6, 0.0, 50.0, j2=False)
    problem = Problem().about(orbit)
    ring = pro_states(1.0, 0.3, np.arange(3) * 2.0, 0.1, problem.mean_motion, 0.0)
    tables = []
    for name, time in (("a", 0.0), ("b", problem.duration)):
        origin, frame = orbit.frames(np.array(time))
        rows = (origin + frame.to_inertial(ring)).tolist()
        tables.append(write_csv(tmp_path / f"{name}.csv", METRES, rows))
    chief = write_csv(tmp_path / "c.csv", ELEMENTS, [(7e6, 0.0, 50.0, 0.0, 0.0, 0.0)])
    made = scenario_from_inertial(*tables, Problem(), chief=chief, j2=False)
    assert made.ends == "passive"
    faster = (tables[1].craft + 0.01 * np.eye(6)[3]).tolist()
    goal = write_csv(tmp_path / "d.csv", METRES, faster)
    drifting = scenario_from_inertial(tables[0], goal, Problem(), chief=chief, j2=False)
    assert drifting.ends == "any"


def test_states_that_do_not_go_together_are_refused(tmp_path):
    def table(name, *rows):
        return write_csv(tmp_path / name, ELEMENTS, rows)

    chief, two, one = table("c.csv", CHIEF), table("2.csv", *CRAFT), table("1.csv", CRAFT[0])
    far = table("far.csv", *CRAFT, (9e6, 0.05, 51.6, 30.0, 40.0, 10.0))
    fast = write_csv(tmp_path / "f.csv", KILOMETRES, [(7000.0, 0.0, 0.0, 0.0, 12.0, 0.0)])
    metres = write_csv(tmp_path / "m.csv", KILOMETRES, [(7e6, 0.0, 0.0, 0.0, 7546.0, 0.0)])
    for initial, goal, given, words in (
        (two, one, chief, "initial has 2 states and goal has 1"),
        (two, two, two, "2.csv has 2 craft; expected one, the chief"),
        (far, far, chief, "expected positions within"),
        (one, one, fast, "has eccentricity 1.52"),
        (metres, metres, None, "craft 0 7e+06 km from the Earth's centre; expected 6378.14"),
        (one, one, replace(chief, frame="ICRF"), "expected one frame for all"),
    ):
        with pytest.raises(InputError) as error:
            scenario_from_inertial(initial, goal, Problem(time_step=0.01), chief=given)
        assert words in str(error.value)


def test_ephemerides_without_the_first_node_s_time_are_refused(handed_over, tmp_path):
    _, folder, _ = handed_over
    table = write_csv(tmp_path / "t.csv", ELEMENTS, [CHIEF] * 3)
    with pytest.raises(InputError, match=r"has states over time; .* give its epoch"):
        scenario_from_inertial(table, read_inertial(folder), Problem())


def test_bad_tables_are_refused_one_by_one(tmp_path):
    head, row = ",".join(METRES), "7e6,0,0,0,7546,0"
    elements = ",".join(ELEMENTS)
    for text, words in (
        ("", "has 0 rows"),
        (head, "has 0 rows"),
        (f"x,y,z,vx,vy,vz\n{row}", "has the columns x,y,z,vx,vy,vz; expected x_m,y_m"),
        (f"{head},mass\n{row},1", "has the columns x_m,"),
        (f"{head},x_m\n{row},1", "has a column twice"),
        (f"{head}\n{row},1", "row 1 has 7 values"),
        (f"{head}\n{row}\n7e6,0,0", "row 2 has vx_m_s ''; expected a number"),
        (f"{head}\n7e6,0,nan,0,1,1", "row 1 has z_m nan"),
        (f"{head}\n7e6,0,1e300,0,1,1", "row 1 has z_m 1e+300"),
        (f"{elements}\n7e6,0.99,0,0,0,0", "row 1: eccentricity is 0.99; expected a number from 0"),
        (f"{elements}\n7000,0.1,0,0,0,0", "row 1: semi_major_axis is 7000 m"),
        ("x" * 200_000, "is not CSV"),
        (f"{head}\n{'7' * 200_000}", "is not CSV"),
        ("[1, 2]", "is no list of objects"),
        ("{}", "is no list of objects"),
        ("[{", "is not JSON"),
        ('[{"x_m": 7e6, "x_m": 8e6}]', "x_m is there twice; expected each field once"),
        (json.dumps([dict.fromkeys(METRES, "7e6")]), "row 1 has x_m '7e6'; expected a number"),
        (json.dumps([dict.fromkeys(METRES, True)]), "row 1 has x_m True"),
        ("\ufeff<xml/>\n", "has 0 rows"),
    ):
        (tmp_path / "t").write_text(text)
        with pytest.raises(InputError) as error:
            read_inertial(tmp_path / "t")
        assert words in str(error.value), text
        assert "\n" not in str(error.value)
    (tmp_path / "b").write_bytes(b"\xff\x00")
    for path, words in (("b", "cannot be read"), ("none.csv", "cannot be read"), (".", "0 files")):
        with pytest.raises(InputError, match=words):
            read_inertial(tmp_path / path)


def test_an_ephemeris_is_read_from_a_pipe_too(handed_over, tmp_path):
    _, folder, _ = handed_over
    file = sorted(folder.glob("*.oem"))[0]
    os.mkfifo(tmp_path / "pipe")
    writer = Thread(target=(tmp_path / "pipe").write_bytes, args=(file.read_bytes(),))
    writer.start()
    piped = read_inertial(tmp_path / "pipe")
    writer.join()
    assert piped.states(EPOCH, 0.0) == pytest.approx(read_inertial(file).states(EPOCH, 0.0))


def test_files_are_in_the_order_of_their_numbers(handed_over, tmp_path):
    _, folder, _ = handed_over
    for name, source in (("sat-10.oem", 0), ("sat-9.oem", 1), ("b.oem", 2)):
        text = (folder / f"craft-{source}.oem").read_text()
        (tmp_path / name).write_text(text)
    names = [one.name.rpartition("/")[2] for one in read_inertial(tmp_path).craft]
    assert names == ["b.oem", "sat-9.oem", "sat-10.oem"]
    (tmp_path / "a.oem").write_text(text.replace("EME2000", "ICRF"))
    with pytest.raises(InputError, match="expected one frame for all"):
        read_inertial(tmp_path)
