"""What `import prolearn` gives does what the commands do, and its plans stand before the judge."""

import json
import re
from dataclasses import fields, is_dataclass, replace
from datetime import UTC, datetime, timedelta, timezone
from decimal import Decimal
from fractions import Fraction
from functools import partial
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
import pytest
import torch
from judge import judge_plan

import prolearn
from pipeline.plan.document import plan_document
from prolearn import InputError, Reference, Ring

PNG = b"\x89PNG"
OUTER, INNER = Ring(craft=3, size=150, tilt_deg=20), Ring(craft=3, size=100, tilt_deg=-20)


def swap(**changes):
    """Two rings of three craft that change places."""
    initial = [OUTER, INNER | {"first_phase_deg": 60.0}]
    goal = [INNER | {"first_phase_deg": 45.0}, OUTER | {"first_phase_deg": 60.0}]
    return prolearn.scenario(initial, goal, name="swap", **changes)


@pytest.fixture(scope="module")
def plan():
    return prolearn.plan(swap())


HUGE = 10**400  # no float
AXES = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
BOX = prolearn.Box((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))
NAN = float("nan")
MINUTES = np.timedelta64(20, "m")
NOON = datetime(2026, 3, 1, 12, tzinfo=UTC)
EARLY = datetime(1961, 1, 1, 0, 30, tzinfo=timezone(timedelta(hours=2)))  # of 1960 in UTC


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: prolearn.Waypoint(0, (1, 2)), r"position of a waypoint is \(1, 2\); expected 3"),
        (lambda: prolearn.Waypoint(0, (NAN, 0, 0)), "position of a waypoint"),
        (lambda: prolearn.Waypoint(0, None), "position of a waypoint is None; expected 3 finite"),
        (lambda: prolearn.Waypoint(0, (0, 0, 0), (0, NAN, 0)), "velocity of a waypoint"),
        (lambda: prolearn.Waypoint(0, (0, 0, 0), time=NAN), "time of a waypoint is nan"),
        (lambda: prolearn.Box((-1, -1), (1, 1)), "min of a box"),
        (lambda: prolearn.Cone((0, NAN, 0), (0, 1, 0), 10), "apex of a cone"),
        (lambda: prolearn.Obstacle("o", (0,) * 6, semi_axes=(1, 2)), "semi_axes of obstacle 'o'"),
        (lambda: prolearn.Thrust(objective="least"), "objective is 'least'; expected total or"),
        (lambda: replace(swap().problem, thrust="norm"), "thrust is 'norm'; expected Thrust"),
        (lambda: replace(swap().problem, orbit=7e6), "orbit is 7000000.0; expected ReferenceOrbit"),
        (lambda: prolearn.Spacecraft("a\udcff"), r"name is 'a\\udcff'; expected text without h"),
        (lambda: prolearn.Obstacle("a\ud800", (0,) * 6, 3), r"name is 'a\\ud800'; expected text w"),
        (lambda: prolearn.Waypoint(1.5, (0, 0, 0)), "craft of a waypoint is 1.5; expected a"),
        (lambda: prolearn.Obstacle("o", 5, 3), "state of obstacle 'o' is 5; expected 6 finite"),
        (lambda: prolearn.Corridor((0, 1), 0, 60), "inside of a corridor is .*expected Box"),
        (lambda: prolearn.Corridor(BOX, "0", 60), "begin of a corridor is '0'; expected a finite"),
        (lambda: prolearn.Corridor(BOX, 0, 60, 2), "craft of a corridor is 2; expected craft's"),
        (lambda: replace(swap(), problem=1), "problem is 1; expected Problem"),
        (lambda: replace(swap(), ends="free"), "ends is 'free'; expected passive or any"),
        (lambda: replace(swap(), craft=[1]), "craft is .1.; expected a list of Spacecraft"),
        (lambda: replace(swap(), waypoints=1), "waypoints is 1; expected a list of Waypoint"),
        (lambda: prolearn.plan(swap().initial), "scenario is array.*; expected Scenario"),
        (lambda: prolearn.check({}), "scenario is {}; expected Scenario"),
        (lambda: prolearn.tradeoff(None, 1200, 1440), "scenario is None; expected Scenario"),
        (lambda: prolearn.show(swap()), "plan is Scenario.*; expected Plan"),
        (lambda: prolearn.scenario_from_files("a", "b", epoch=5), "epoch is 5; expected a date"),
        (lambda: prolearn.plan(swap(), risk=1e-3), "risk is 0.001; expected a RiskLimit"),
        (lambda: prolearn.Requirements("never"), "separation is 'never'; expected continuous or"),
        (lambda: prolearn.RiskLimit(1e-3), "risk is 0.001 and no error is given"),
        (lambda: prolearn.RiskLimit(1e-3, 0.0, 0.0, 0.0), "no error is given"),
        (lambda: prolearn.RiskLimit(1e-3, errors=prolearn.Errors(missed=0.1)), "no error is given"),
        (lambda: prolearn.Requirements(pd.Series(["nodes"])), "separation is .*; expected continu"),
        (lambda: prolearn.Thrust(pd.NA), "thrust is <NA>; expected components, norm or a list"),
        (lambda: prolearn.Obstacle("o", (0,) * 6, pd.NA), "expected 3 finite numbers"),
        (lambda: prolearn.Obstacle("o", (0,) * 6, semi_axes=()), r"is \(\); expected 3 finite"),
        (lambda: prolearn.Obstacle("o", (0,) * 6, pd.Series([1.0, 2.0])), "expected 3 finite num"),
        (lambda: prolearn.Problem(time_step=MINUTES), "time_step is .*; expected a number from"),
        (lambda: prolearn.Problem(time_step=Fraction(HUGE)), "time_step is .*; expected a number"),
        (lambda: prolearn.Spacecraft(mass=np.timedelta64("NaT")), "mass is .*; expected a number"),
        (lambda: Reference(NOON, 51.6, MINUTES, 0), "raan_deg is .*; expected a finite number"),
        (lambda: prolearn.draw("rings", MINUTES, 4, 0, prolearn.Problem()), "seed is .*; expected"),
        (lambda: prolearn.tradeoff(swap(), MINUTES, 1800), "duration is 20 minutes to 1800 s; exp"),
        (lambda: prolearn.tradeoff(swap(), Fraction(5, 2), 1800), "duration begins at 2.5 s; exp"),
        (lambda: prolearn.RiskLimit(1e-3, 0.1, errors=prolearn.COLD_GAS), "a sigma is given besid"),
        (lambda: prolearn.RiskLimit("1e-3", 0.1), "risk is '1e-3'; expected a probability"),
        (lambda: prolearn.RiskLimit(1e-3, "0.1"), "navigation_sigma is '0.1'; expected a number"),
        (lambda: prolearn.RiskLimit(1e-3, errors="cold-gas"), "errors is 'cold-gas'; expected Un"),
        (lambda: prolearn.tradeoff(swap(), NAN, 1200), "duration is nan to 1200 s"),
        (lambda: Reference(NOON.replace(tzinfo=None), 51.6, 0, 0), "12:00:00; expected a datetime"),
        (lambda: Reference(NOON.replace(year=1900), 51.6, 0, 0), "between 1960 and 2200"),
        (lambda: Reference(pd.NaT, 51.6, 0, 0), "epoch is NaT; expected a datetime with its zone"),
        (lambda: Reference(EARLY, 51.6, 0, 0), "epoch is 1961-01-01 00:30.*between 1960 and 2200"),
        (lambda: Reference("2026-03-01T12:00:00Z", 51.6, 0, 0), "epoch is 2026-03-01T12:00:00Z"),
        (lambda: Reference(NOON, 200, 0, 0), "inclination_deg is 200"),
        (lambda: Reference(NOON, 51.6, NAN, 0), "raan_deg is nan"),
        (lambda: Reference(NOON, 51.6, 0, "1"), "argument_of_latitude_deg is '1'"),
        (lambda: replace(swap(), goal=swap().goal * 1j), "goal is no array of numbers .*complex"),
        (lambda: swap(max_acceleration=np.True_), "max_acceleration is True: input should be a v"),
        (lambda: prolearn.Problem(nodes=11.5), "nodes is 11.5; expected a whole number"),
        (lambda: prolearn.Problem(nodes=True), "nodes is True; expected a whole number"),
        (lambda: prolearn.Problem(time_step="a"), "time_step is 'a'; expected a number from"),
        (lambda: prolearn.Problem(mean_motion=None), "mean_motion is None; expected a number"),
        (lambda: prolearn.Problem(collision_radius=True), "collision_radius is True; expected a"),
        (lambda: prolearn.Spacecraft(mass="1"), "mass is '1'; expected a number from"),
        (lambda: prolearn.Box("abc", (1, 1, 1)), "min of a box is abc; expected 3 finite"),
        (lambda: replace(swap(), reference=1), "reference is 1; expected Reference or None"),
        (lambda: swap(orbit=7e6), "orbit is 7000000.0; expected ReferenceOrbit or None"),
        (lambda: swap(orbit=prolearn.ReferenceOrbit(7e6), altitude=7e5), "give one of .* altitude"),
        (lambda: prolearn.draw("rings", 0, 4, 0, None), "problem is None; expected Problem"),
        (lambda: replace(swap(), name=5), "name is 5; expected str"),
        (lambda: replace(swap(), name=Path("a")), r"name is \w+\('a'\); expected str"),
        (lambda: prolearn.planner(None), "planner is None; expected str"),
        (lambda: prolearn.planner("expert", 1e-3), "requirements is 0.001; expected Requirements"),
        (lambda: prolearn.plan_all(swap()), "scenarios is Scenario.*; expected a list of Scenario"),
        (lambda: prolearn.plan_all([swap()], 5), "planner is 5; expected str or Planner"),
        (lambda: prolearn.tradeoff(swap(), "20", 1800), "duration is 20 to 1800 s; expected"),
        (lambda: prolearn.write_scenario(swap(), "s.json"), "scenario is 's.json'; expected"),
        (lambda: prolearn.read_scenario(5), "path is 5; expected str or PathLike"),
        (lambda: prolearn.read_plan(None), "path is None; expected str or PathLike"),
        (lambda: prolearn.read_dataset(5, 3), "path is 5; expected str or PathLike"),
        (lambda: prolearn.scenario_from_files(5, "b"), "path is 5; expected str or PathLike"),
        (lambda: prolearn.read_plan("a\0b"), r"path is 'a\\x00b'; expected one without a null"),
        *(
            (partial(kind, no_burn=no_burn), words)
            for kind in (prolearn.Thrust, prolearn.Spacecraft)
            for no_burn, words in (
                (None, "no_burn is None; expected a list"),
                ((300, 500), r"no_burn is \(300, 500\); expected a list"),
                ([(0, 9), (1, 2, 3)], r"no_burn\[1\] is \(1, 2, 3\); expected 2 finite numbers"),
                ([("300", "500")], r"no_burn\[0\] is .*; expected 2 finite numbers"),
                ([(1000, float("inf"))], r"no_burn\[0\] is \(1000, inf\); expected 2 finite numb"),
            )
        ),
        (lambda: prolearn.Settings(stop="first"), "stop is 'first'; expected converged or first"),
        (lambda: prolearn.Settings(solver="highs"), "solver is 'highs'; expected simplex or clara"),
        (lambda: prolearn.Settings(margin=NAN), "margin is nan; expected a number from 0 to"),
        (lambda: prolearn.Settings(starts=0), "starts is 0; expected a number from 1 to"),
        (lambda: prolearn.Settings(max_rounds=2.5), "max_rounds is 2.5; expected a whole number"),
        (lambda: prolearn.Thrust(None), "thrust is None; expected components, norm or a list"),
        (lambda: prolearn.Thrust([*AXES, (1, 0)]), r"thrust\[6\] is \(1, 0\); expected 3 finite"),
        (lambda: prolearn.Thrust([("1", 0, 0)] * 4), r"thrust\[0\] is .*; expected 3 finite"),
        (lambda: prolearn.Cone((0, 0, 0), (1, 0, 0), "30"), "half_angle_deg of a cone is '30'"),
        (lambda: prolearn.Cone((0, 0, 0), (1, 0, 0), 1e-300), "a half-angle of 1e-300 deg; expect"),
        (lambda: prolearn.ReferenceOrbit(7e6).states(np.array([NAN])), "times are .*expected fin"),
        (lambda: prolearn.ReferenceOrbit(7e6).states(np.array([-60.0])), "times are .*from 0 on"),
        (lambda: prolearn.ReferenceOrbit.through(np.full(6, NAN)), "state is .*expected 6 fin"),
        (lambda: prolearn.ReferenceOrbit.through(np.zeros(6)), "state is at the Earth's centre"),
        (lambda: prolearn.load_model(None), "reference is None; expected str"),
        (lambda: prolearn.Problem().about(None), "orbit is None; expected ReferenceOrbit"),
        (lambda: prolearn.Cone((0, 0, 0), (1, 0, 0), None), "half_angle_deg of a cone is None"),
        (lambda: prolearn.Conditions(ballistic="0.02"), "ballistic is '0.02'; expected a finite"),
        (
            lambda: prolearn.ReferenceOrbit(7e6, ballistic="x"),
            "ballistic is 'x'; expected a finite",
        ),
        (lambda: prolearn.ReferenceOrbit(None), "semi_major_axis is None; expected a finite"),
        (lambda: prolearn.Problem(mean_motion=HUGE), "mean_motion is 1000.*000; expected a number"),
        (lambda: prolearn.ReferenceOrbit(HUGE), "semi_major_axis is 1000.*000; expected a finite"),
        (lambda: prolearn.Conditions(ballistic=HUGE), "ballistic is 1000.*000; expected a finite"),
        (lambda: prolearn.Cone((0, 0, 0), (1, 0, 0), HUGE), "half_angle_deg of a cone is 1000"),
        (lambda: prolearn.Obstacle("o", (0,) * 6, HUGE), "expected 3 finite numbers"),
        (lambda: replace(swap(), goal=[[HUGE] * 6] * 6), "goal is no array of numbers"),
        (lambda: prolearn.Requirements(passive_safety=HUGE), "asked for over 1000.* orbits"),
        (lambda: prolearn.scenario([OUTER], int), "goal"),
        (lambda: prolearn.draw(["rings"], 0, 4, 0, prolearn.Problem()), "family is .'rings'.; exp"),
        (
            lambda: prolearn.draw(np.array(["rings"]), 0, 4, 0, prolearn.Problem()),
            "family is array.*; expected rings or",
        ),
        (
            lambda: prolearn.Problem(time_step=Decimal(120)),
            "time_step is Decimal.*; expected a num",
        ),
        (
            lambda: prolearn.plan(swap(), prolearn.Planner),
            "planner is <class .*; expected str or Pl",
        ),
        (lambda: prolearn.Conditions(j2="no"), "j2 is 'no'; expected bool"),
        (lambda: prolearn.ReferenceOrbit(7e6, j2=0), "j2 is 0; expected bool"),
        (
            lambda: prolearn.Obstacle("o", (0,) * 6, 3, hold="false"),
            "hold is 'false'; expected bool",
        ),
        (
            lambda: prolearn.RiskLimit(1e-3, 0.1, closed_loop="no"),
            "closed_loop is 'no'; expected b",
        ),
        (lambda: prolearn.plan(swap(), "refiner", raw="no"), "raw is 'no'; expected bool"),
        (lambda: prolearn.plan(swap(), allow_drift="no"), "allow_drift is 'no'; expected bool"),
        (lambda: prolearn.Spacecraft(name=5), "name is 5; expected str"),
        (lambda: prolearn.Obstacle(5, (0,) * 6, 3), "name is 5; expected str"),
        (lambda: replace(swap(), goal=swap().goal.astype(str)), "goal is no array .*they are str"),
        (
            lambda: replace(swap(), goal=swap().goal.astype(str).tolist()),
            "goal is no array of numb",
        ),
        (lambda: replace(swap(), goal=np.zeros((6, 6), "m8[s]")), "they are timedelta64"),
        (
            lambda: replace(swap(), goal=np.array([["1"] * 6], object)),
            "goal is no array of numbers",
        ),
        (
            lambda: replace(swap(), goal=np.ma.masked_equal(swap().goal, swap().goal[4, 1])),
            r"goal\[4\] has a value that is not a finite number",
        ),
    ],
)
def test_values_of_another_kind_or_shape_are_refused_in_a_sentence(wrong, words):
    with pytest.raises(InputError, match=words):
        wrong()


def test_a_scenario_stays_as_it_was_made_where_the_callers_arrays_change():
    initial, goal = swap().initial.copy(), swap().goal.copy()
    made = prolearn.Scenario(prolearn.Problem(), initial, goal)
    initial += 1.0
    goal += 1.0
    assert (made.initial == swap().initial).all() and (made.goal == swap().goal).all()


def test_numpys_numbers_and_arrays_are_planned_compared_and_written(tmp_path):
    def made(number, whole, array):
        thrust = prolearn.Thrust("norm", number(0.5), no_burn=array([[0, 100]]))
        problem = prolearn.Problem(
            time_step=number(120), collision_radius=whole(15), nodes=whole(11), thrust=thrust
        )
        box = prolearn.Box(array([-900.0] * 3), array([900.0] * 3))
        cone = prolearn.Cone(array([0.0, -900.0, 0.0]), array([0.0, 1.0, 0.0]), number(80))
        return replace(
            swap(),
            problem=problem,
            craft=(prolearn.Spacecraft(radius=number(8)),) * 6,
            corridors=(
                prolearn.Corridor(box, whole(0), number(600), craft=tuple(array(range(2)))),
                prolearn.Corridor(cone, number(120), whole(240), craft=array([3])),
            ),
            waypoints=(prolearn.Waypoint(whole(0), array([1.0, 2, 3]), time=number(600)),),
            obstacles=(
                prolearn.Obstacle("o", array([0.0] * 6), semi_axes=array([1.0, 2, 3]), hold=True),
            ),
        )

    numpys, pythons = made(np.float32, np.int64, np.array), made(float, int, list)
    for name in ("problem", "craft", "corridors", "waypoints", "obstacles"):
        assert getattr(numpys, name) == getattr(pythons, name)
        hash(getattr(numpys, name))
    assert prolearn.Problem(nodes=11.0) == prolearn.Problem()
    for scenario, name in ((numpys, "numpy.json"), (pythons, "python.json")):
        prolearn.write_scenario(tmp_path / name, scenario)
    written = (tmp_path / "numpy.json").read_text()
    assert json.loads(written) == json.loads((tmp_path / "python.json").read_text())
    assert prolearn.read_scenario(tmp_path / "numpy.json").corridors == pythons.corridors


def test_an_epoch_of_another_zone_is_that_moment_in_utc(plan, tmp_path):
    here = NOON.astimezone(timezone(timedelta(hours=9)))
    placed = swap(reference=Reference(here, np.float32(51.5), 0, 0))
    assert placed.reference == Reference(NOON, 51.5, 0.0, 0.0)
    (file, *_) = prolearn.convert(replace(plan, scenario=placed), "oem", tmp_path)
    assert "START_TIME = 2026-03-01T12:00:00" in file.read_text()
    prolearn.write_scenario(tmp_path / "placed.json", placed)
    assert prolearn.read_scenario(tmp_path / "placed.json").reference == placed.reference


def test_what_is_asked_with_numpys_numbers_and_flags_is_written_and_compared(tmp_path):
    plan = prolearn.plan(swap(), "straight-line", passive_safety=np.float32(0.5))
    prolearn.write_plan(tmp_path / "plan.json", plan)
    assert prolearn.read_plan(tmp_path / "plan.json").certificate.passive_safety.orbits == 0.5
    for made in (
        lambda number, flag: prolearn.RiskLimit(number(0.5), number(2), closed_loop=flag(1)),
        lambda number, flag: prolearn.Requirements("continuous", number(0.5)),
        lambda number, flag: prolearn.Conditions(number(0.5), number(30), j2=flag(0)),
        lambda number, flag: prolearn.Problem(time_step=number(120)),
    ):
        python = made(float, bool)
        kinds = [type(value) for value in vars(python).values()]
        for number in (np.float32, np.longdouble, Fraction):
            other = made(number, np.bool_)
            assert other == python and hash(other) == hash(python)
            assert [type(value) for value in vars(other).values()] == kinds


def test_thrust_may_be_made_of_lists():
    lists = prolearn.Thrust([*map(list, AXES)], no_burn=[[100, 200]])
    assert lists == prolearn.Thrust(tuple(AXES), no_burn=((100, 200),))
    assert hash(lists) == hash(prolearn.Thrust(tuple(AXES), no_burn=((100, 200),)))


def is_sound(plan):
    document = json.loads(json.dumps(plan_document(plan), allow_nan=False))
    return judge_plan(document["scenario"], document).wrong == ()


def test_a_scenario_of_rings_is_that_of_a_file_with_the_same_rings(tmp_path):
    fields = {
        "schema": "prolearn.scenario/1",
        "altitude": 600e3,
        "nodes": 9,
        "initial": {"rings": [dict(OUTER), INNER | {"first_phase_deg": 60.0}]},
        "goal": {"rings": [INNER | {"first_phase_deg": 45}, OUTER | {"first_phase_deg": 60}]},
    }
    (tmp_path / "swap.json").write_text(json.dumps(fields))
    read, made = prolearn.read_scenario(tmp_path / "swap.json"), swap(altitude=600e3, nodes=9)
    assert read.problem == made.problem
    assert (read.initial == made.initial).all() and (read.goal == made.goal).all()


def test_a_scenario_of_states_takes_arrays_and_lists_and_numpys_numbers():
    rings = swap()
    wide = partial(np.array, dtype=np.longdouble)
    for kind in (np.array, np.ndarray.tolist, list, wide, pd.DataFrame, torch.tensor):
        of_states = prolearn.scenario(
            kind(rings.initial), kind(rings.goal), nodes=np.int64(11), altitude=np.float64(500e3)
        )
        assert (of_states.initial == rings.initial).all()
        assert of_states.problem == rings.problem
        by_class = prolearn.Scenario(rings.problem, kind(rings.initial), kind(rings.goal))
        assert (by_class.goal == rings.goal).all() and type(by_class.goal) is np.ndarray


def test_one_ring_needs_no_list_and_its_fields_are_named():
    alone, listed = prolearn.scenario(OUTER, INNER), prolearn.scenario([OUTER], [INNER])
    assert (alone.initial == listed.initial).all() and (alone.goal == listed.goal).all()
    as_in_files = prolearn.scenario({"rings": [OUTER]}, {"rings": [INNER]})
    assert (as_in_files.initial == listed.initial).all()
    with pytest.raises(InputError, match=r"initial\.rings\[0\]\.siez is not a field"):
        prolearn.scenario({"craft": 2, "siez": 3.0}, INNER)


@pytest.mark.parametrize(
    ("ends", "words"),
    [
        (([Ring(craft=2, size=-1.0)], [OUTER]), r"initial\.rings\[0\]\.size is -1"),
        (([{"craft": 2, "siez": 3.0}], [OUTER]), "siez"),
        (([OUTER, [0.0] * 6], [OUTER]), r"initial\.rings\[1\]"),
        (([[0.0] * 5], [[0.0] * 6]), r"initial\[0\]"),
        (([OUTER], "far"), "goal"),
    ],
)
def test_a_wrong_end_is_a_sentence_with_its_field(ends, words):
    with pytest.raises(InputError, match=words):
        prolearn.scenario(*ends)


def test_plans_satisfy_what_was_asked(plan):
    assert plan.status == "solved" and is_sound(plan)
    safe = prolearn.plan(plan.scenario, passive_safety=0.5)
    assert safe.certificate.passive_safety.orbits == 0.5 and is_sound(safe)
    alike = prolearn.plan(plan.scenario, assignment="optimal")
    assert alike.certificate.fuel < plan.certificate.fuel and is_sound(alike)
    (first, second) = prolearn.plan_all([plan.scenario] * 2, "refiner")
    assert is_sound(first) and (first.controls == second.controls).all()
    chosen = prolearn.planner("decoupled-optimum")
    assert prolearn.plan(plan.scenario, chosen).status == "unsafe"


def test_formations_that_nothing_can_start_from_are_refused():
    close = prolearn.scenario([Ring(phases_deg=[0.0, 1.0], size=100)], [Ring(craft=2, size=100)])
    wrong = [str(finding) for finding in prolearn.check(close) if not finding.fine]
    assert any(text.startswith("initial, craft apart: WRONG") for text in wrong)
    with pytest.raises(InputError, match="collision_radius"):
        prolearn.plan(close)


def test_ends_that_drift_are_refused_with_cures_that_work_in_python():
    drifting = prolearn.Scenario(prolearn.Problem(), [[0, 0, 0, 0, 0.01, 0]], [[0, 90, 0, 0, 0, 0]])
    for ask in (prolearn.plan, lambda one: prolearn.plan_all([one])):
        with pytest.raises(InputError, match=r'say "ends": "any" .*allow_drift=True'):
            ask(drifting)
    assert prolearn.plan(drifting, allow_drift=True).status == "solved"
    assert prolearn.plan_all([replace(drifting, ends="any")])[0].status == "solved"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"passive_safety": 0.5}, "decoupled optimum is given with options"),
        ({"separation": "nodes"}, "decoupled optimum is given with options"),
        ({"effort": "best"}, "decoupled optimum is given with options"),
        ({"raw": True}, "decoupled optimum is given with options"),
        ({"assignment": "optimal"}, "decoupled optimum is given with options"),
    ],
)
def test_a_planner_that_is_there_takes_no_options_in_silence(plan, options, words):
    with pytest.raises(InputError, match=words):
        prolearn.plan(plan.scenario, prolearn.planner("decoupled-optimum"), **options)


class Nearly:
    """A planner object without the attribute ``requirements``."""

    name = "nearly"

    def plan(self, scenarios):
        return prolearn.planner("straight-line").plan(scenarios)


class Straight(Nearly):
    requirements = prolearn.Requirements()


class Forgetful(Straight):
    def plan(self, scenarios):
        return super().plan(scenarios)[1:]


class Stranger(Straight):
    def plan(self, scenarios):
        return scenarios


def test_an_object_with_name_requirements_and_plan_is_a_planner(plan):
    assert prolearn.plan(plan.scenario, Straight()).planner == "straight line"
    assert prolearn.monte_carlo(plan, 1, replan=Straight()).summaries[1].planner == "nearly"


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda p: prolearn.plan(p.scenario, effort="fast"), "effort is 'fast'; expected first or"),
        (lambda p: prolearn.plan(p.scenario, assignment="best"), "assignment is 'best'"),
        (lambda p: prolearn.plan(p.scenario, "nobody"), "planner is 'nobody'"),
        (lambda p: prolearn.plan(p.scenario, separation="never"), "separation is 'never'"),
        (lambda p: prolearn.tradeoff(p.scenario, 1200, 1440, goal="far"), "goal is 'far'"),
        (lambda p: prolearn.convert(p, "xlsx", "plan.xlsx"), "to is 'xlsx'; expected oem or"),
        (lambda p: prolearn.plot(p).write("plan.bmp"), "plan.bmp"),
        (lambda p: prolearn.monte_carlo(p, 0), "trials is 0"),
        (lambda p: prolearn.monte_carlo(p, 2, seed=-1), "seed is -1"),
        (lambda p: prolearn.monte_carlo(p, 2, size=-1.0), "size is -1"),
        (lambda p: prolearn.monte_carlo(p, 2, replan="expert", sigmas=-1.0), "sigmas is -1"),
        (lambda p: prolearn.monte_carlo(p, 3.0), "trials is 3.0; expected a whole number"),
        (lambda p: prolearn.monte_carlo(p, 2, errors="cold-gas"), "errors is 'cold-gas'; expected"),
        (lambda p: prolearn.tradeoff(p.scenario, 1200, 1800, steps=3.0), "steps is 3.0; expected"),
        (lambda p: prolearn.draw("rings", 0, 4.0, 0, prolearn.Problem()), "n is 4.0; expected a"),
        (lambda p: prolearn.plan(p.scenario, passive_safety="1"), "asked for over '1' orbits"),
        (lambda p: prolearn.plan(p.scenario, world="yes"), "world is 'yes'; expected Conditions"),
        (lambda p: prolearn.fly(p, 1), "conditions is 1; expected Conditions or None"),
        (lambda p: prolearn.monte_carlo(p, 1, conditions="x"), "conditions is 'x'; expected Cond"),
        (lambda p: prolearn.monte_carlo(p, 1, conditions=[]), "conditions is ..; expected Condit"),
        (lambda p: prolearn.tradeoff(p.scenario, HUGE, 1e4), "duration is 10.* s; expected"),
        (lambda p: swap(craft=None), "craft is None; expected a list of Spacecraft"),
        (lambda p: swap(craft=[{}] * 6), "craft is .*; expected a list of Spacecraft"),
        (lambda p: swap(obstacles=[1]), "obstacles is .1.; expected a list of Obstacle"),
        (lambda p: prolearn.plan_all([1]), "scenarios is .1.; expected a list of Scenario"),
        (lambda p: prolearn.plan(p.scenario, Forgetful()), "nearly returned 0 plans for 1 scen"),
        (lambda p: prolearn.plan(p.scenario, Forgetful(), world=True), "nearly returned 0 plans"),
        (lambda p: prolearn.tradeoff(p.scenario, 1200, 1440, planner=Forgetful()), "returned 0 pl"),
        (lambda p: prolearn.monte_carlo(p, 1, replan=Forgetful()), "nearly returned 0 plans"),
        (lambda p: prolearn.plan_all([p.scenario], Stranger()), "nearly returned is .*of Plan"),
        (lambda p: prolearn.read_dataset("ds", "3"), "n is '3'; expected a whole number"),
        (lambda p: prolearn.read_dataset("ds", 3, columns="fuel"), "columns is 'fuel'; expected a"),
        (lambda p: prolearn.read_plan("nothing.json"), "nothing.json cannot be read"),
        (lambda p: prolearn.plan(p.scenario, None), "planner is None; expected str or Planner"),
        (lambda p: prolearn.plan(p.scenario, 5, raw=True), "planner is 5; expected str or Planner"),
        (lambda p: prolearn.monte_carlo(p, 2, replan=Nearly()), "replan is .*expected str or Plan"),
        (lambda p: prolearn.write_plan(p, "plan.json"), "plan is 'plan.json'; expected Plan"),
        (lambda p: prolearn.write_plan("a", replace(p, planner="\udcff")), "planner is .*halves"),
        (lambda p: prolearn.write_plan(5, p), "path is 5; expected str or PathLike"),
        (lambda p: prolearn.convert(p.scenario, "csv", "p.csv"), "plan is Scenario.*expected Plan"),
        (lambda p: prolearn.convert(p, "csv", None), "path is None; expected str or PathLike"),
        (lambda p: prolearn.convert(p, "burns", "b", mass=iter([4.0] * 6)), "mass is <.*; exp"),
        (lambda p: prolearn.convert(p, "burns", "b", mass=[[1], [2, 3]]), "mass is .1., .2, 3.; e"),
        (lambda p: prolearn.plot(p).write(5), "path is 5; expected str or PathLike"),
        (lambda p: prolearn.show(p, 5), "name is 5; expected str"),
        (lambda p: prolearn.monte_carlo(p, 1, size=MINUTES), "size is .*; expected a number from"),
        (lambda p: prolearn.convert(p, "burns", "b", mass=MINUTES), "mass is .*; expected a num"),
        (lambda p: prolearn.show(p).write(None), "path is None; expected str or PathLike"),
    ],
)
def test_what_makes_no_sense_is_a_sentence(plan, tmp_path, monkeypatch, ask, words):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=words):
        ask(plan)
    assert list(tmp_path.iterdir()) == []


def test_numpys_integers_and_any_iterable_of_scenarios_are_taken(plan):
    flown = [prolearn.monte_carlo(plan, 2, seed=kind(1)) for kind in (int, np.int32, np.uint32)]
    assert len({one.summaries for one in flown}) == 1
    three, problem = np.uint8(3), prolearn.Problem()
    drawn = prolearn.draw("rings", three, three, three, problem)
    assert drawn.name == prolearn.draw("rings", 3, 3, 3, problem).name
    planned = prolearn.plan_all((one for one in [plan.scenario]), "straight-line")
    objects = np.array([plan.scenario], dtype=object)
    assert len(planned) == len(prolearn.plan_all(objects, "straight-line")) == 1


@pytest.mark.parametrize("name", ["expert", "refiner", "straight-line"])
@pytest.mark.parametrize("assignment", ["given", "optimal"])
def test_planners_take_any_iterable_of_scenarios_and_refuse_what_is_none(plan, name, assignment):
    chosen = prolearn.planner(name, assignment=assignment)
    assert len(chosen.plan(one for one in [plan.scenario])) == 1
    nothing = np.array(plan.scenario, dtype=object)  # of no dimension, so that it has no rows
    for wrong in ([1], plan.scenario, None, [[plan.scenario]], "abc", nothing):
        with pytest.raises(InputError, match=r"scenarios is .*; expected a list of Scenario"):
            chosen.plan(wrong)


def test_an_array_of_no_dimension_is_no_list(plan):
    with pytest.raises(InputError, match=r"scenarios is array.*; expected a list of Scenario"):
        prolearn.plan_all(np.array(plan.scenario, dtype=object))
    with pytest.raises(InputError, match="nothing to plot in array"):
        prolearn.plot(np.array(plan, dtype=object))
    for wrong in (5, np.array("fuel")):
        with pytest.raises(InputError, match=r"columns is .*; expected a list of str"):
            prolearn.read_dataset("ds", 3, columns=wrong)


def test_tables_and_numbers_of_other_libraries_mean_what_lists_and_floats_do(plan):
    place = pd.Series([30.0, -80.0, 20.0])
    assert prolearn.Waypoint(0, place) == prolearn.Waypoint(0, (30.0, -80.0, 20.0))
    assert prolearn.Waypoint(0, torch.tensor(place)) == prolearn.Waypoint(0, (30.0, -80.0, 20.0))
    assert prolearn.Thrust(pd.DataFrame(AXES)) == prolearn.Thrust(AXES)
    half = np.float16(0.5)
    found = [prolearn.monte_carlo(plan, 2, size=one, sigmas=one) for one in (half, 0.5)]
    assert type(found[0].size) is float and found[0].summaries == found[1].summaries


def test_formations_that_are_too_close_are_refused_by_all_that_plans():
    close = prolearn.scenario([Ring(phases_deg=[0.0, 1.0], size=100)], [Ring(craft=2, size=100)])
    for ask in (lambda: prolearn.plan_all([close]), lambda: prolearn.tradeoff(close, 1200, 1440)):
        with pytest.raises(InputError, match="collision_radius"):
            ask()


def test_states_that_drift_are_planned_in_a_list_where_they_may(plan):
    drifting = replace(plan.scenario, goal=plan.scenario.goal + np.eye(6)[4] / 100)
    with pytest.raises(InputError, match=r"allow_drift=True"):
        prolearn.plan_all([drifting])
    (found,) = prolearn.plan_all([drifting], allow_drift=True)
    assert found.status == "solved"


def test_goals_that_drift_at_other_times_are_traded_off_where_they_may():
    about = prolearn.Problem().about(prolearn.ReferenceOrbit(7e6, 0.05, 50.0))
    scenario = prolearn.draw("rings", 5, 3, 0, about, "valid")
    with pytest.raises(InputError, match=r"allow_drift=True"):
        prolearn.tradeoff(scenario, 600, 720)
    for given in ({"allow_drift": True}, {"goal": "moving"}):
        points = prolearn.tradeoff(scenario, 600, 720, **given)
        assert [point.plan.status for point in points] == ["solved", "solved"]


def test_what_is_printed_is_short_and_says_what_matters(plan):
    assert repr(plan.scenario) == "Scenario(swap, 6 craft, 10 intervals of 120 s)"
    said = repr(plan)
    assert said.startswith("Plan(6 craft by expert, solved; Δv ") and len(said) < 120
    assert f"{plan.certificate.min_separation:.2f} m" in said
    effect = prolearn.fly(plan)[-1]
    assert repr(effect).startswith("Effect(name='J2', nearest=Separation(")
    flown = prolearn.monte_carlo(plan, 2)
    for one in (effect, flown, *flown.summaries, prolearn.planner("refiner"), plan.scenario):
        assert len(repr(one)) < 1000 and "array" not in repr(one)


def test_a_plan_is_read_as_it_was_written(plan, tmp_path):
    prolearn.write_plan(str(tmp_path / "plan.json"), plan)
    read = prolearn.read_plan(str(tmp_path / "plan.json"))
    assert (read.controls == plan.controls).all()
    assert read.scenario.problem == plan.scenario.problem


def test_a_flight_is_that_of_the_command(plan, tmp_path, forked):
    prolearn.write_plan(tmp_path / "plan.json", plan)
    done = forked.run(["fly", "plan.json", "--json"], tmp_path)
    told = json.loads(done.stdout)["effects"]
    flown = prolearn.fly(plan)
    assert [one.name for one in flown] == [row["effect"] for row in told]
    for one, row in zip(flown, told, strict=True):
        assert np.linalg.norm(one.errors[:, :3], axis=1).max() == row["goal_error"]


def test_a_monte_carlo_is_that_of_the_command(plan, tmp_path, forked):
    prolearn.write_plan(tmp_path / "plan.json", plan)
    asked = ["--trials", "6", "--replan", "every-node", "--seed", "3", "--jobs", "1"]
    done = forked.run(["fly", "plan.json", *asked, "--json"], tmp_path)
    told = json.loads(done.stdout)["loops"]
    found = prolearn.monte_carlo(plan, 6, replan="expert", seed=3)
    for row, summary in zip(told, found.summaries, strict=True):
        for name in ("loop", "sigmas", "within_radius", "goal_error_high", "delta_v_median"):
            assert getattr(summary, name) == row[name]
    assert prolearn.plot(found)._repr_png_().startswith(PNG)
    assert found.figure().get_suptitle() == "swap: n = 6, 6 trials"
    unnamed = replace(plan, scenario=replace(plan.scenario, name=""))
    assert replace(found, plan=unnamed).figure().get_suptitle() == "n = 6, 6 trials"


def test_the_reference_orbit_of_a_scenario_is_flown(plan):
    from datetime import UTC, datetime

    where = Reference(datetime(2026, 3, 1, tzinfo=UTC), 51.6, 0.0, 0.0)
    (inclined,) = prolearn.planner().plan([swap(reference=where)])
    usual, other = prolearn.fly(plan)[-1], prolearn.fly(inclined)[-1]
    assert not np.allclose(usual.errors, other.errors)


def test_a_trade_off_has_a_sound_plan_for_each_duration_and_a_figure(plan):
    points = prolearn.tradeoff(plan.scenario, 1200.0, 1800.0, steps=3)
    assert [point.duration for point in points] == [1200.0, 1440.0, 1800.0]
    assert all(is_sound(point.plan) for point in points)
    assert prolearn.plot(points)._repr_png_().startswith(PNG)
    unnamed = replace(plan, scenario=replace(plan.scenario, name=""))
    titles = [
        prolearn.plot([replace(points[0], plan=one)]).figure.axes[0].get_title("left")
        for one in (plan, unnamed)
    ]
    assert titles == ["swap: n = 6, arcs of 120 s", "n = 6, arcs of 120 s"]


def test_a_page_stands_in_a_notebook_and_in_a_file(plan, tmp_path):
    page = prolearn.show(plan)
    inside = page._repr_html_()
    assert inside.startswith("<iframe srcdoc=") and inside.count("<") == 2, "all else is escaped"
    assert page.write(tmp_path / "plan.html").read_text() == page.html
    assert len(repr(page)) < 80
    assert (
        prolearn.plot([prolearn.plan(plan.scenario, "decoupled-optimum"), plan])
        ._repr_png_()
        .startswith(PNG)
    )
    assert prolearn.plot(plan).write(tmp_path / "plan.svg").read_text().count("<svg") == 1
    for nothing in ([], [1], 1, [plan, 1], None):
        with pytest.raises(InputError, match="nothing to plot in"):
            prolearn.plot(nothing)


def test_plans_by_one_planner_have_a_panel_each(plan):
    titles = [ax.get_title() for ax in prolearn.plot([plan, plan, plan]).figure.axes]
    assert titles == ["Expert", "Expert (2)", "Expert (3)"]
    other = prolearn.plan(swap(collision_radius=14.0), "straight-line")
    with pytest.raises(InputError, match="plans 0 and 1 have other states"):
        prolearn.plot([plan, other])


def test_a_notebooks_figure_is_the_same_whatever_the_callers_matplotlib_is_set_to(plan):
    usual = prolearn.plot(plan)._repr_png_()
    with matplotlib.rc_context({"savefig.facecolor": "red", "grid.alpha": 0.1, "font.size": 20}):
        assert prolearn.plot(plan)._repr_png_() == usual


def test_a_notebooks_figure_has_a_name_that_cannot_be_drawn_as_escapes(plan):
    named = [replace(plan, scenario=replace(plan.scenario, name=one)) for one in ("a\udcff", "\0")]
    for one, shown in zip(named, (r"a\udcff", r"\x00"), strict=True):
        plot = prolearn.plot(one)
        assert plot._repr_png_().startswith(PNG)
        assert plot.figure.get_suptitle() == shown


@pytest.mark.parametrize(
    ("field", "change", "words"),
    [
        ("controls", lambda p: p.controls[:, :-1], r"\(6, 9, 3\); expected \(6, 10, 3\)"),
        ("states", lambda p: p.states[0], r"states .* \(11, 6\); expected \(6, 11, 6\)"),
        ("controls", lambda p: None, "controls of a plan are no array of numbers"),
        ("controls", lambda p: p.controls.astype(str), "controls of a plan are no array of num"),
        ("scenario", lambda p: prolearn.draw("rings", 0, 4, 0, prolearn.Problem()), "shape"),
        ("scenario", lambda p: None, "scenario is None; expected Scenario"),
        ("certificate", lambda p: None, "certificate is None; expected Certificate"),
        ("message", lambda p: None, "message is None; expected str"),
        ("separation", lambda p: "never", "separation is 'never'; expected continuous or nodes"),
        ("as_flown", lambda p: True, "as flown about an orbit, and its scenario has none"),
    ],
)
def test_a_plan_with_a_field_that_makes_no_plan_is_refused(plan, field, change, words):
    with pytest.raises(InputError, match=words):
        replace(plan, **{field: change(plan)})


def test_controls_of_ones_own_are_taken_as_lists_and_what_no_file_can_hold_is_refused(
    plan, tmp_path
):
    own = replace(plan, controls=plan.controls.tolist())
    assert np.array_equal(own.controls, plan.controls)
    assert prolearn.show(own).html == prolearn.show(plan).html
    for wrong in ({"controls": np.ma.masked_equal(plan.controls, 0.0)}, {"status": "Solved"}):
        with pytest.raises(InputError, match=r"not finite|status is 'Solved'; expected solved or"):
            prolearn.write_plan(tmp_path / "plan.json", replace(plan, **wrong))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("to", ["csv", "parquet", "burns"])
def test_a_plan_is_written_for_other_tools(plan, tmp_path, to):
    (file,) = prolearn.convert(plan, to, tmp_path / f"plan.{to}")
    assert file.stat().st_size > 1000


def test_masses_go_into_what_is_written(plan, tmp_path):
    where = Reference(datetime(2026, 3, 1, tzinfo=UTC), 97.4, 40.0, 0.0)
    placed = replace(plan, scenario=replace(plan.scenario, reference=where))
    masses = {"mass": np.linspace(4, 9, plan.scenario.n).tolist(), "specific_impulse": 220}
    files = prolearn.convert(placed, "opm", tmp_path / "opm", **masses)
    assert len(files) == plan.scenario.n and "MASS = 9\n" in files[-1].read_text()
    with pytest.raises(InputError, match="csv has no place for it"):
        prolearn.convert(plan, "csv", tmp_path / "plan.csv", mass=4.0)


def test_every_public_name_is_there_and_documented():
    for name in prolearn.__all__:
        assert getattr(prolearn, name) is not None
        assert name == "COLD_GAS" or name == "FAMILIES" or getattr(prolearn, name).__doc__
    page = (Path(__file__).parents[2] / "docs/api.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\.\. [a-z:]+:: prolearn\.(\w+)$", page, re.MULTILINE)
    assert sorted(listed) == sorted(prolearn.__all__)


def test_every_field_of_a_public_value_is_described():
    """As an attribute in the docstring of its class or a base, which the page of names shows."""
    missing = []
    for value in (getattr(prolearn, name) for name in prolearn.__all__):
        if is_dataclass(value) and isinstance(value, type) and len(fields(value)) > 1:
            told = "\n".join(one.__doc__ or "" for one in value.__mro__[:-1])
            missing += [(value, one.name) for one in fields(value) if f"{one.name}: " not in told]
    assert missing == []


def test_thrusters_and_craft_of_their_own_are_given_and_kept():
    craft = [prolearn.Spacecraft(name="a", delta_v=3.0), prolearn.Spacecraft(delta_v=2.0)]
    thrust = prolearn.Thrust("norm", 0.01, no_burn=((300.0, 500.0),), objective="fair")
    swarm = prolearn.scenario(
        initial=[prolearn.Ring(craft=2, size=150)],
        goal=[prolearn.Ring(craft=2, size=100)],
        thrust=thrust,
        craft=craft,
    )
    plan = prolearn.plan(swarm)
    assert (plan.status, plan.scenario.craft) == ("solved", tuple(craft))
    assert np.all(plan.controls[:, 2:5] == 0)
    share = plan.certificate.largest_share
    spent = np.array(plan.certificate.craft_delta_v_2norm)
    assert share.share == pytest.approx((spent / [3.0, 2.0]).max())
