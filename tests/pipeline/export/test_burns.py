"""Lists of burns, and OPM files as the independent reader ``ccsds_ndm`` sees them."""

import csv
import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from ccsds_ndm.ndm_io import NdmIo
from judge.motion import exact_step
from judge.thrusters import Thrusters
from oem import OrbitEphemerisMessage
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from thrusting import AXES, EIGHT

from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.export import write_plan_as
from pipeline.export.messages import write_ephemerides, write_orbit_parameters
from pipeline.export.tables import Masses, write_burns
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import Reference
from pipeline.orbit.thrust import Thrust
from pipeline.scenario import draw
from pipeline.scenario.document import document_of
from pipeline.scenario.spacecraft import Spacecraft

WHERE = Reference(datetime(2026, 3, 1, 23, 55, 0, 250000, tzinfo=UTC), 97.4, 40.0, 350.0)
MU = 3.986004418e14
FOURTEEN = (*AXES, *EIGHT)
MASS, IMPULSE = [12.0, 14.0, 100.0], 220.0
ORDER = re.compile(
    r"CCSDS_OPM_VERS (COMMENT )*CREATION_DATE ORIGINATOR OBJECT_NAME OBJECT_ID CENTER_NAME "
    r"REF_FRAME TIME_SYSTEM EPOCH X Y Z X_DOT Y_DOT Z_DOT MASS ((COMMENT )*MAN_EPOCH_IGNITION "
    r"MAN_DURATION MAN_DELTA_MASS MAN_REF_FRAME MAN_DV_1 MAN_DV_2 MAN_DV_3 )*"
)
"""Keywords of an OPM in the order of tables 3-1 to 3-3 of CCSDS 502.0-B-3, those that we need."""


@pytest.fixture(scope="module")
def made():
    return solve(replace(draw("rings", 0, 3, 3, Problem(time_step=100 / 3)), reference=WHERE))


def rows_of(plan, path, **masses):
    write_burns(plan, path, Masses.of(plan.scenario.n, **masses))
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def axes_at(seconds, mean_motion):
    """LVLH axes of the circular orbit as columns, by its three angles."""
    along = WHERE.argument_of_latitude_deg + np.degrees(mean_motion * seconds)
    angles = [WHERE.raan_deg, WHERE.inclination_deg, along]
    return Rotation.from_euler("ZXZ", angles, degrees=True).as_matrix()


def test_a_row_is_an_interval_with_thrust_and_coasts_have_none(made, tmp_path):
    rows = rows_of(made, tmp_path / "b.csv")
    thrusting = made.controls.any(axis=2)
    assert 0 < thrusting.sum() < thrusting.size
    assert [(int(r["craft"]), int(r["node"])) for r in rows] == list(
        zip(*map(np.ndarray.tolist, np.nonzero(thrusting)), strict=True)
    )
    rate = made.scenario.problem.mean_motion
    for row in rows:
        craft, node, start = int(row["craft"]), int(row["node"]), float(row["time_s"])
        held = [float(row[f"u{axis}"]) for axis in "xyz"]
        assert held == made.controls[craft, node].tolist()
        assert (start, float(row["duration_s"])) == (node * 100 / 3, 100 / 3)
        told = datetime.fromisoformat(row["utc"])
        assert abs(told - WHERE.epoch - timedelta(seconds=start)) <= timedelta(microseconds=1)
        inertial = [float(row[f"u{axis}_eme2000"]) for axis in "xyz"]
        middle = axes_at(start + 50 / 3, rate) @ held
        assert inertial == pytest.approx(middle, rel=1e-9, abs=1e-15)
        assert [row[name] for name in ("mass", "force", "propellant")] == ["", "", ""]


def test_velocities_of_a_craft_sum_to_those_of_its_certificate(made, tmp_path):
    rows = rows_of(made, tmp_path / "b.csv")
    for column, of in (("delta_v", "craft_delta_v"), ("delta_v_2norm", "craft_delta_v_2norm")):
        for craft, asked in enumerate(getattr(made.certificate, of)):
            used = sum(float(row[column]) for row in rows if int(row["craft"]) == craft)
            assert used == pytest.approx(asked, rel=1e-12)


def test_masses_follow_tsiolkovsky(made, tmp_path):
    rows = rows_of(made, tmp_path / "b.csv", mass=MASS, specific_impulse=IMPULSE)
    for craft, before in enumerate(MASS):
        own = [row for row in rows if int(row["craft"]) == craft]
        left = before
        for row in own:
            assert float(row["mass"]) == pytest.approx(left, rel=1e-12)
            size = np.linalg.norm([float(row[f"u{axis}"]) for axis in "xyz"])
            assert float(row["force"]) == pytest.approx(left * size, rel=1e-12)
            left -= float(row["propellant"])
        used = made.certificate.craft_delta_v[craft]
        assert left == pytest.approx(before / np.exp(used / (220 * 9.80665)), rel=1e-12)


def test_a_craft_whose_impulse_is_not_known_keeps_its_mass(made, tmp_path):
    some = [IMPULSE, *[None] * (len(MASS) - 1)]
    rows = rows_of(made, tmp_path / "b.csv", mass=MASS, specific_impulse=some)
    both = rows_of(made, tmp_path / "c.csv", mass=MASS, specific_impulse=IMPULSE)
    of_first = [row for row in rows if row["craft"] == "0"]
    assert of_first == [row for row in both if row["craft"] == "0"]
    for row in rows[len(of_first) :]:
        assert float(row["mass"]) == MASS[int(row["craft"])]
        assert row["propellant"] == ""


def test_what_is_not_known_is_empty(made, tmp_path):
    nowhere = replace(made, scenario=replace(made.scenario, reference=None))
    rows = rows_of(nowhere, tmp_path / "b.csv", mass=2.0)
    assert {(row["utc"], row["ux_eme2000"], row["propellant"]) for row in rows} == {("", "", "")}
    assert {float(row["mass"]) for row in rows} == {2.0}
    still = draw("rings", 0, 1, 0, Problem())
    still = replace(still, initial=np.zeros((1, 6)), goal=np.zeros((1, 6)), reference=WHERE)
    assert rows_of(solve(still), tmp_path / "none.csv") == []


@pytest.mark.parametrize(
    ("masses", "words"),
    [
        ({"mass": [1.0, 2.0]}, "mass is 1, 2; expected a number from 1e-12 to 1e.06 for all"),
        ({"mass": -1.0}, "mass is -1;"),
        ({"mass": float("nan")}, "mass is nan;"),
        ({"mass": 1e300}, r"mass is 1e\+300;"),
        ({"mass": 1.0, "specific_impulse": 1e308}, r"specific_impulse is 1e\+308;"),
        ({"mass": 1.0, "specific_impulse": 1e-320}, "specific_impulse is 9.99989e-321;"),
        ({"mass": 1.0, "specific_impulse": 0.0}, "specific_impulse is 0;"),
        ({"mass": None, "specific_impulse": 220.0}, "without mass"),
    ],
)
def test_masses_that_are_none_are_refused(masses, words):
    with pytest.raises(InputError, match=words):
        Masses.of(3, **masses)


@pytest.fixture(scope="module")
def messages(made, tmp_path_factory):
    folder = tmp_path_factory.mktemp("opm")
    files = write_orbit_parameters(made, folder, "my plan", Masses.of(3, MASS, IMPULSE))
    return files, [NdmIo().from_path(file).body.segment for file in files]


def test_an_opm_has_the_keywords_of_the_standard_in_its_order(messages):
    for file in messages[0]:
        text = file.read_text(encoding="ascii")
        keys = "".join(f"{line.split()[0]} " for line in text.splitlines())
        assert ORDER.fullmatch(keys), keys
        assert max(map(len, text.splitlines())) <= 254


def test_an_opm_has_the_state_of_the_ephemeris_at_the_first_node(made, messages, tmp_path):
    ephemerides = write_ephemerides(made, tmp_path, "p")
    for segment, file, mass in zip(messages[1], ephemerides, MASS, strict=True):
        first = next(iter(next(iter(OrbitEphemerisMessage.open(file).segments)).states))
        state = segment.data.state_vector
        numbers = [getattr(state, k).value for k in ("x", "y", "z", "x_dot", "y_dot", "z_dot")]
        assert numbers == pytest.approx(first.vector, rel=0, abs=1e-11)
        assert state.epoch == "2026-03-01T23:55:00.250000"
        assert segment.metadata.ref_frame == "EME2000"
        assert segment.data.spacecraft_parameters.mass.value == mass


def test_masses_of_an_opm_are_those_of_the_list(made, messages, tmp_path):
    rows = rows_of(made, tmp_path / "b.csv", mass=MASS, specific_impulse=IMPULSE)
    told = [one for segment in messages[1] for one in segment.data.maneuver_parameters]
    assert len(told) == len(rows)
    for one, row in zip(told, rows, strict=True):
        assert one.man_delta_mass.value == pytest.approx(-float(row["propellant"]), rel=1e-12)
        assert one.man_epoch_ignition + "Z" == row["utc"]


def test_its_burns_held_in_inertial_axes_lead_nearly_to_the_goal(made, messages):
    """Within what docs/files.md says, less here, where intervals are shorter."""
    problem = made.scenario.problem
    radius = np.cbrt(MU / problem.mean_motion**2)
    for segment, goal in zip(messages[1], made.scenario.goal, strict=True):
        state = segment.data.state_vector
        names = ("x", "y", "z", "x_dot", "y_dot", "z_dot")
        flown = 1e3 * np.array([getattr(state, name).value for name in names])
        held = np.zeros((problem.intervals, 3))
        for one in segment.data.maneuver_parameters:
            since = datetime.fromisoformat(one.man_epoch_ignition + "Z") - WHERE.epoch
            added = [one.man_dv_1.value, one.man_dv_2.value, one.man_dv_3.value]
            held[round(since.total_seconds() * 0.03)] = (
                1e3 * np.array(added) / one.man_duration.value
            )

        def motion(_, s, push):
            return np.concatenate([s[3:], push - MU * s[:3] / np.linalg.norm(s[:3]) ** 3])

        for push in held:
            span = (0, problem.time_step)
            flown = solve_ivp(motion, span, flown, args=(push,), rtol=1e-12, atol=1e-9).y[:, -1]
        axes = axes_at(problem.duration, problem.mean_motion)
        assert axes.T @ flown[:3] - [radius, 0, 0] == pytest.approx(goal[:3], abs=0.1)


def test_a_burn_of_many_revolutions_adds_what_it_does_in_closed_form(tmp_path):
    """Inertial Δv of constant in-plane thrust: sin(θ/2)/(θ/2) remains as the axes turn by θ."""
    problem = Problem(time_step=1e5, nodes=3)
    plan = solve(replace(draw("rings", 0, 1, 3, problem), reference=WHERE))
    (path,) = write_orbit_parameters(plan, tmp_path, "p", Masses.of(1, 12.0, IMPULSE))
    half = problem.mean_motion * problem.time_step / 2
    burnt = []
    for k, u in enumerate(plan.controls[0]):
        left = np.array([np.sin(half) / half, np.sin(half) / half, 1.0])
        middle = axes_at((k + 0.5) * problem.time_step, problem.mean_motion)
        burnt.append(middle @ (left * u) * problem.time_step)
    told = NdmIo().from_path(path).body.segment.data.maneuver_parameters
    for one, wanted in zip(told, burnt, strict=True):
        added = 1e3 * np.array([one.man_dv_1.value, one.man_dv_2.value, one.man_dv_3.value])
        assert added == pytest.approx(wanted, abs=1e-9)


def test_an_opm_without_masses_or_a_place_is_refused(made, tmp_path):
    with pytest.raises(InputError, match=r"expected mass \(kg\) and specific_impulse \(s\)"):
        write_orbit_parameters(made, tmp_path, "p", Masses.of(3, 12.0))
    with pytest.raises(InputError, match="such as 12 and 220"):
        write_orbit_parameters(made, tmp_path, "p", Masses.of(3))
    nowhere = replace(made, scenario=replace(made.scenario, reference=None))
    with pytest.raises(InputError, match='"reference"'):
        write_orbit_parameters(nowhere, tmp_path, "p", Masses.of(3, 12.0, 220.0))
    assert list(tmp_path.iterdir()) == []


def test_an_opm_without_burns_needs_no_mass(made, tmp_path):
    problem = made.scenario.problem
    A, _ = exact_step(problem.mean_motion, problem.duration)
    plan = solve(replace(made.scenario, goal=made.scenario.initial @ A.T))
    assert not plan.controls.any()
    for name, masses in (("bare", Masses.of(3)), ("dry", Masses.of(3, MASS))):
        for path in write_orbit_parameters(plan, tmp_path / name, name, masses):
            said = path.read_text()
            assert "MAN_" not in said
            assert ("MASS" in said) == (name == "dry")
            state = NdmIo().from_path(path).body.segment.data.state_vector
            assert state.epoch.startswith("2026-03-01T23:55:00.25")


def test_thrusters_at_their_limits_spend_what_the_certificate_says(tmp_path):
    """Where the cheapest thrusters for a control are at their limit, dearer ones help."""
    scenario = draw("rings", 0, 3, 3, Problem(thrust=Thrust(FOURTEEN)))
    limit = 0.15 * float(np.linalg.norm(solve(scenario).controls, axis=2).max())
    plan = solve(replace(scenario, problem=replace(scenario.problem, max_acceleration=limit)))
    assert plan.status == "solved"
    rows = rows_of(plan, tmp_path / "b.csv")
    document = document_of(plan.scenario)
    step, thrusters = plan.scenario.problem.time_step, Thrusters.of(document, 3)
    spent = step * thrusters.firings(plan.controls).sum(axis=(1, 2))
    for craft, used in enumerate(spent):
        listed = sum(float(row["delta_v"]) for row in rows if int(row["craft"]) == craft)
        assert listed == pytest.approx(used, rel=1e-5)
    for row in rows:
        fired = [float(row[f"thrust_{k}"]) for k in range(14)]
        assert 0 <= min(fired) <= max(fired) <= limit * (1 + 1e-6)
        assert step * sum(fired) == pytest.approx(float(row["delta_v"]), rel=1e-6)
        held = [float(row[f"u{axis}"]) for axis in "xyz"]
        assert np.array(fired) @ FOURTEEN == pytest.approx(held, abs=1e-9 * limit)


def test_masses_and_the_kind_of_thrust_are_the_scenarios(made, tmp_path):
    own = tuple(Spacecraft(mass=mass) for mass in MASS)
    problem = replace(made.scenario.problem, thrust=Thrust("norm"))
    plan = solve(replace(made.scenario, problem=problem, craft=own))
    files = write_plan_as("burns", plan, tmp_path / "b.csv", "b", specific_impulse=IMPULSE)
    with files[0].open(newline="") as file:
        rows = list(csv.DictReader(file))
    for craft, mass in enumerate(MASS):
        mine = [row for row in rows if int(row["craft"]) == craft]
        assert float(mine[0]["mass"]) == mass
        used = [float(row["delta_v"]) for row in mine]
        assert used == pytest.approx([float(row["delta_v_2norm"]) for row in mine], rel=1e-12)
        left = mass * np.exp(-sum(used) / (9.80665 * IMPULSE))  # Tsiolkovsky
        taken = sum(float(row["propellant"]) for row in mine)
        assert mass - taken == pytest.approx(left, rel=1e-12)
    total = sum(float(row["delta_v"]) for row in rows)
    assert total == pytest.approx(plan.certificate.delta_v, rel=1e-9)
    write_plan_as("burns", plan, tmp_path / "b.csv", "b", mass=9.0)
    with files[0].open(newline="") as file:
        assert {row["mass"] for row in csv.DictReader(file)} == {"9.0"}


def test_a_mass_that_one_craft_has_is_its_own_and_those_of_others_are_not_known(made, tmp_path):
    own = (Spacecraft(mass=3.0), *[Spacecraft()] * (made.scenario.n - 1))
    plan = solve(replace(made.scenario, craft=own))
    write_plan_as("burns", plan, tmp_path / "b.csv", "b", specific_impulse=IMPULSE)
    with (tmp_path / "b.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    first = [row for row in rows if row["craft"] == "0"]
    assert first[0]["mass"] == "3.0" and all(float(row["propellant"]) > 0 for row in first)
    others = {row[name] for row in rows for name in ("mass", "propellant") if row["craft"] != "0"}
    assert others == {""}
    (script,) = write_plan_as("basilisk", plan, tmp_path / "b.py", "b")
    assert "\nMASSES = [3.0, 1.0, 1.0]\n" in script.read_text()
    with pytest.raises(InputError, match="masses of the craft are not known"):
        write_plan_as("opm", plan, tmp_path / "opm", "b", specific_impulse=IMPULSE)
