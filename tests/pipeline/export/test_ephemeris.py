"""OEM files, read by the independent reader ``oem`` and turned back to LVLH by other formulas."""

import itertools
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from astropy.time import Time, TimeDelta
from oem import OrbitEphemerisMessage
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.export.messages import write_ephemerides
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import Reference, mean_motion_at
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.scenario import draw

WHERE = Reference(datetime(2026, 3, 1, 23, 55, 0, 250000, tzinfo=UTC), 97.4, 40.0, 350.0)

PROBLEMS = {
    "the reference problem": Problem(nodes=6),
    "nodes between microseconds": Problem(time_step=100 / 3, nodes=6),
    "hours in a geostationary orbit": Problem(
        mean_motion=mean_motion_at(35786e3), time_step=7200.0, nodes=5
    ),
}


@pytest.fixture(scope="module", params=PROBLEMS, ids=str)
def handed_over(request, tmp_path_factory):
    """A plan, its scenario, and what the reader makes of each craft's file."""
    scenario = replace(draw("rings", 0, 2, 3, PROBLEMS[request.param]), reference=WHERE)
    plan = solve(scenario)
    folder = tmp_path_factory.mktemp("oem")
    files = write_ephemerides(plan, folder, "my plan")
    return plan, scenario, [OrbitEphemerisMessage.open(file) for file in files]


def in_lvlh(state, seconds, mean_motion):
    """Relative state (m, m/s) from an inertial one in km, by cross products as in textbooks."""
    r0 = np.cbrt(3.986004418e14 / mean_motion**2)
    turn = np.degrees(mean_motion * seconds)
    angles = [WHERE.raan_deg, WHERE.inclination_deg, WHERE.argument_of_latitude_deg + turn]
    to_inertial = Rotation.from_euler("ZXZ", angles, degrees=True)
    r, v = to_inertial.apply([[r0, 0, 0], [0, r0 * mean_motion, 0]])
    momentum = np.cross(r, v)
    radial, cross = r / np.linalg.norm(r), momentum / np.linalg.norm(momentum)
    axes = np.stack([radial, np.cross(cross, radial), cross])
    apart = 1e3 * state.position - r
    moving = 1e3 * state.velocity - v - np.cross(momentum / (r @ r), apart)
    return np.concatenate([axes @ apart, axes @ moving])


def since_epoch(time):
    return (time - Time(WHERE.epoch.replace(tzinfo=None), scale="utc")).sec


def rounding(plan):
    """What velocities may be off since epochs are whole microseconds and thrust jumps, m/s."""
    return 1e-9 + 1e-6 * np.abs(plan.controls).max()


def flown(start, control, mean_motion, seconds):
    """Eq. 1 by numerical integration."""
    e = mean_motion

    def derivative(_, s):
        x, _, z, vx, vy, vz = s
        ux, uy, uz = control
        return [vx, vy, vz, 3 * e**2 * x + 2 * e * vy + ux, -2 * e * vx + uy, -(e**2) * z + uz]

    return solve_ivp(derivative, (0, seconds), start, rtol=1e-12, atol=1e-12).y[:, -1]


def test_a_file_has_a_segment_for_each_arc_and_they_are_contiguous(handed_over):
    plan, scenario, messages = handed_over
    assert len(messages) == scenario.n
    for message in messages:
        assert message.version == "2.0"
        segments = list(message.segments)
        assert len(segments) == scenario.problem.intervals
        for one, other in itertools.pairwise(segments):
            assert one.metadata["STOP_TIME"] == other.metadata["START_TIME"]
            end, start = list(one.states)[-1], next(iter(other.states))
            assert 1e3 * end.position == pytest.approx(1e3 * start.position, abs=1e-6)
            assert 1e3 * end.velocity == pytest.approx(1e3 * start.velocity, abs=rounding(plan))
        assert {segment.metadata["REF_FRAME"] for segment in segments} == {"EME2000"}
        assert all(len(list(segment.states)) >= 8 for segment in segments)


def test_states_at_nodes_are_the_plans_once_turned_back_to_lvlh(handed_over):
    plan, scenario, messages = handed_over
    e, step = scenario.problem.mean_motion, scenario.problem.time_step
    for craft, message in enumerate(messages):
        for node, segment in enumerate(message.segments):
            first = next(iter(segment.states))
            seconds = since_epoch(first.epoch)
            assert seconds == pytest.approx(node * step, abs=1e-6)
            back = in_lvlh(first, seconds, e)
            asked = plan.states[craft, node]
            asked = asked + (seconds - node * step) * np.append(asked[3:], np.zeros(3))
            assert back[:3] == pytest.approx(asked[:3], abs=1e-6)
            assert back[3:] == pytest.approx(asked[3:], abs=rounding(plan))


def test_states_that_the_reader_interpolates_are_the_plans_motion_under_thrust(handed_over):
    plan, scenario, messages = handed_over
    e, step = scenario.problem.mean_motion, scenario.problem.time_step
    worst = 0.0
    for craft, message in enumerate(messages):
        for arc, segment in enumerate(message.segments):
            for share in (0.03, 0.5, 0.71):
                time = segment.metadata["START_TIME"] + TimeDelta(share * step, format="sec")
                seconds = since_epoch(time)
                back = in_lvlh(segment(time), seconds, e)
                asked = flown(
                    plan.states[craft, arc], plan.controls[craft, arc], e, seconds - arc * step
                )
                worst = max(worst, np.abs(back - asked)[:3].max())
    assert worst < 1e-6


@pytest.mark.parametrize("e", [0.3, 0.7, 0.85])
def test_an_eccentric_orbit_is_interpolated_to_a_micrometre_at_its_perigee(e, tmp_path):
    """The truth is Kepler's equation, solved by Newton's method."""
    a, step = 7e6 / (1 - e), 1200.0
    rate = np.sqrt(3.986004418e14 / a**3)
    orbit = ReferenceOrbit(a, e, 51.6, 40.0, 30.0, 30.0, j2=False)  # which begins at perigee
    scenario = draw("rings", 0, 1, 0, Problem(time_step=step, nodes=4).about(orbit))
    still = np.zeros((1, 6))
    scenario = replace(scenario, initial=still, goal=still, reference=WHERE)
    (file,) = write_ephemerides(solve(scenario), tmp_path, "p")
    turned = Rotation.from_euler("ZXZ", [40.0, 51.6, 30.0], degrees=True)
    worst = 0.0
    for segment in OrbitEphemerisMessage.open(file).segments:
        epochs = [state.epoch for state in segment.states]
        for first, then in itertools.pairwise(epochs):
            time = first + (then - first) / 2
            mean = rate * since_epoch(time)
            eccentric = mean
            for _ in range(50):
                off = eccentric - e * np.sin(eccentric) - mean
                eccentric -= off / (1 - e * np.cos(eccentric))
            in_plane = np.cos(eccentric) - e, np.sqrt(1 - e**2) * np.sin(eccentric), 0.0
            truth = turned.apply(a * np.array(in_plane))
            worst = max(worst, np.abs(1e3 * segment(time).position - truth).max())
    assert worst < 1e-6


def test_a_craft_at_the_origin_flies_the_two_body_orbit(tmp_path):
    scenario = draw("rings", 0, 1, 0, Problem(time_step=300.0))
    still = np.zeros((1, 6))
    scenario = replace(scenario, initial=still, goal=still, reference=WHERE)
    (file,) = write_ephemerides(solve(scenario), tmp_path, "p")
    states = [s for segment in OrbitEphemerisMessage.open(file).segments for s in segment.states]
    start, end = states[0], states[-1]

    def gravity(_, s):
        return np.concatenate([s[3:], -398600.4418 * s[:3] / np.linalg.norm(s[:3]) ** 3])

    flown = solve_ivp(gravity, (0, 3000), start.vector, rtol=1e-12, atol=1e-12).y[:, -1]
    assert end.vector == pytest.approx(flown, abs=1e-6)  # km


def test_however_long_the_plans_name_no_line_is_longer_than_ccsds_allows(tmp_path):
    scenario = replace(draw("rings", 0, 2, 3, PROBLEMS["the reference problem"]), reference=WHERE)
    files = write_ephemerides(solve(scenario), tmp_path, "x" * 255)
    assert max(len(line) for file in files for line in file.read_text().splitlines()) <= 254
    segments = [next(iter(OrbitEphemerisMessage.open(file).segments)) for file in files]
    first, second = (segment.metadata["OBJECT_NAME"] for segment in segments)
    assert (first.endswith("-craft-0"), second.endswith("-craft-1")) == (True, True)


def test_what_cannot_be_handed_over_is_refused(tmp_path):
    scenario = draw("rings", 0, 2, 0, Problem())
    plan = solve(scenario)
    with pytest.raises(InputError, match='"reference"'):
        write_ephemerides(plan, tmp_path, "p")
    plan = replace(plan, scenario=replace(scenario, reference=WHERE))
    with pytest.raises(InputError, match=r"off those that its controls lead to over one interval;"):
        write_ephemerides(replace(plan, states=plan.states * 1.001), tmp_path, "p")
    assert list(tmp_path.iterdir()) == []
