"""OEM files read: held against the motion that they sample and the reader ``oem``."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from astropy.time import Time
from oem import OrbitEphemerisMessage
from scipy.integrate import solve_ivp

from pipeline.errors import InputError
from pipeline.scenario.oem import ephemeris_from

EPOCH = datetime(2026, 3, 1, 23, 59, 30, tzinfo=UTC)  # the file goes on in the next day
START = [-4500.0, 4800.0, 1900.0, -3.1, -5.2, 5.5]  # km and km/s, of eccentricity 0.2
STEP, COUNT = 30.0, 40


def flown(seconds):
    """Two-body motion, by numerical integration, m and m/s."""

    def gravity(_, s):
        return np.concatenate([s[3:], -398600.4418 * s[:3] / np.linalg.norm(s[:3]) ** 3])

    end = max(seconds)
    solved = solve_ivp(
        gravity,
        (0, end),
        START,
        t_eval=seconds,
        rtol=1e-13,
        atol=1e-13,
        method="DOP853",
        max_step=10,
    )
    return 1e3 * solved.y.T


def stamp(seconds, form="%Y-%m-%dT%H:%M:%S.%f"):
    return (EPOCH + timedelta(seconds=seconds)).strftime(form)


@pytest.fixture(scope="module")
def rows():
    """The lines of an ephemeris."""
    times = STEP * np.arange(COUNT)
    states = [" ".join(f"{v:.15f}" for v in state / 1e3) for state in flown(times)]
    return [f"{stamp(time)} {state}" for time, state in zip(times, states, strict=True)]


def message(rows, method="HERMITE", degree=7, **changed):
    """The text of a file with a segment, and other values of some keywords; None for none."""
    keywords = {
        "OBJECT_NAME": "A",
        "OBJECT_ID": "2026-001A",
        "CENTER_NAME": "EARTH",
        "REF_FRAME": "EME2000",
        "TIME_SYSTEM": "UTC",
        "START_TIME": rows[0].split()[0],
        "STOP_TIME": rows[-1].split()[0],
        "INTERPOLATION": method,
        "INTERPOLATION_DEGREE": degree,
    } | changed
    meta = [f"{name} = {value}" for name, value in keywords.items() if value is not None]
    head = ["CCSDS_OEM_VERS = 2.0", "CREATION_DATE = 2026-01-01T00:00:00", "ORIGINATOR = X"]
    return "\n".join([*head, "", "META_START", *meta, "META_STOP", "COMMENT c", "", *rows]) + "\n"


@pytest.mark.parametrize(
    ("method", "degree", "position", "velocity"),
    [("HERMITE", 7, 1e-5, 1e-6), ("HERMITE", 11, 2e-6, 1e-7), ("LAGRANGE", 9, 1e-4, 1e-6)],
)
def test_between_states_the_motion_is_interpolated(rows, method, degree, position, velocity):
    made = ephemeris_from(message(rows, method, degree), "a.oem")
    times = [0.0, 11.3, 299.99, 600.0, 1000.123, 1169.9]
    found = np.array([made.state_at(EPOCH, time) for time in times])
    truth = flown(times)
    assert found[:, :3] == pytest.approx(truth[:, :3], abs=position)
    assert found[:, 3:] == pytest.approx(truth[:, 3:], abs=velocity)


def test_another_reader_reads_and_interpolates_the_same(rows, tmp_path):
    file = tmp_path / "a.oem"
    file.write_text(message(rows))
    other = OrbitEphemerisMessage.open(file)
    made = ephemeris_from(file.read_text(), "a.oem")
    for seconds in (0.0, 95.5, 610.0, 1111.1):
        time = EPOCH + timedelta(seconds=seconds)
        read = other(Time(time.replace(tzinfo=None), scale="utc"))
        found = made.state_at(time, 0.0)
        assert found[:3] == pytest.approx(1e3 * read.position, abs=1e-4)
        assert found[3:] == pytest.approx(1e3 * read.velocity, abs=1e-5)


def test_a_state_at_the_time_is_taken_as_it_is_and_moved_by_less_than_a_microsecond(rows):
    made = ephemeris_from(message(rows, method=None, degree=None), "a.oem")
    truth = flown([60.0, 60.0000004])
    for seconds, state in zip((60.0, 60.0000004), truth, strict=True):
        assert made.state_at(EPOCH, seconds) == pytest.approx(state, abs=1e-7)
    with pytest.raises(InputError, match=r"no state at 2026-03-02T00:00:40\.000000Z and no INTERP"):
        made.state_at(EPOCH, 70.0)


def test_what_else_a_file_may_have_is_passed_over(rows):
    text = message([f"{row} 0.0 0.0 0.0" for row in rows], REF_FRAME="ICRF")
    covariance = "COVARIANCE_START\nEPOCH = 2026-03-02T00:00:00\n1.0\n0.1 1.0\nCOVARIANCE_STOP\n"
    more = message(rows, REF_FRAME="ICRF").partition("\nMETA_START")[2]
    made = ephemeris_from(text + covariance + "META_START" + more, "a.oem")
    assert made.frame == "ICRF" and len(made.segments) == 2
    assert made.state_at(EPOCH, 95.5) == pytest.approx(flown([0, 95.5])[1], abs=1e-5)
    between = message([*rows[:2], *covariance.splitlines(), *rows[2:]])
    found = ephemeris_from(between, "a.oem").state_at(EPOCH, 95.5)
    assert found == pytest.approx(flown([0, 95.5])[1], abs=1e-5)


def test_covariances_that_do_not_end_are_refused_at_once():
    with pytest.raises(InputError, match="has the line 'COVARIANCE_START'"):
        ephemeris_from(100_000 * "COVARIANCE_START\n", "a.oem")  # ten minutes in squares of them


def test_days_of_the_year_and_digits_beyond_microseconds_are_read(rows):
    form = [
        f"{stamp(STEP * k, '%Y-%jT%H:%M:%S')}.0000000Z {row.partition(' ')[2]}"
        for k, row in enumerate(rows)
    ]
    made = ephemeris_from(message(form), "a.oem")
    assert made.start == EPOCH
    assert made.state_at(EPOCH, 95.5) == pytest.approx(flown([0, 95.5])[1], abs=1e-5)
    late = [form[0].replace("30.0000000Z", "30.0000002Z"), *form[1:]]
    found = ephemeris_from(message(late), "a.oem").state_at(EPOCH, 0.0)
    assert found[:3] == pytest.approx(1e3 * np.array(START[:3]) - 2e-4 * np.array(START[3:]))


def test_states_are_taken_only_where_they_are_said_to_be_usable(rows):
    made = ephemeris_from(
        message(rows, USEABLE_START_TIME=stamp(60), USEABLE_STOP_TIME=stamp(600)), "a.oem"
    )
    assert made.start == EPOCH + timedelta(seconds=60)
    made.state_at(EPOCH, 600.0)
    with pytest.raises(InputError, match=r"has states from 2026-03-02T00:00:30\.000000Z to 2026"):
        made.state_at(EPOCH, 30.0)


def test_usable_times_beyond_the_states_are_not_extrapolated_to(rows):
    wide = {"USEABLE_START_TIME": stamp(-900), "USEABLE_STOP_TIME": stamp(9000)}
    made = ephemeris_from(message(rows, **wide), "a.oem")
    assert made.start == EPOCH
    for seconds in (-1.0, STEP * COUNT):  # the last state is one step earlier
        with pytest.raises(InputError, match="has states from 2026-03-01T23:59:30"):
            made.state_at(EPOCH, seconds)


def test_what_is_not_understood_is_refused_in_a_sentence(rows):
    whole = message(rows)
    for text, words in (
        (whole.replace("VERS = 2.0", "VERS = 9.0"), "has CCSDS_OEM_VERS '9.0'; expected 1.0 or"),
        (message(rows, REF_FRAME="ITRF2000"), "has REF_FRAME 'ITRF2000'; expected EME2000 or"),
        (message(rows, REF_FRAME=None), "has no REF_FRAME; expected EME2000"),
        (message(rows, TIME_SYSTEM="TAI"), "has TIME_SYSTEM 'TAI'; expected UTC"),
        (message(rows, CENTER_NAME="MOON"), "has CENTER_NAME 'MOON'; expected EARTH"),
        (message(rows, "SPLINE"), "has INTERPOLATION 'SPLINE'; expected LINEAR or"),
        (message(rows, degree=99), "has INTERPOLATION_DEGREE '99'; expected 1 to 25"),
        (message(rows, degree=5000 * "9"), "has INTERPOLATION_DEGREE '999"),
        (message(rows, degree=None), "has INTERPOLATION_DEGREE missing; expected"),
        (message([*rows, rows[3]]), "has state 40 of a segment no later than the one before"),
        (message([*rows, rows[3] + " 1"]), "expected an epoch and x y z vx vy vz in km"),
        (message([*rows, rows[3].replace(".", "x")]), "expected an epoch and x y z vx"),
        (message([rows[0].replace(" -4500.0", " nan")]), "expected an epoch and x y z"),
        (message([rows[0].replace("23:59:30", "23:59:60")]), "and no leap second"),
        (message([rows[0].replace("2026-03", "2026-13")]), "has the time '2026-13-01T"),
        (message([rows[0].replace("2026-03-01", "2026-366")]), "has the time '2026-366T"),
        (
            message(rows, USEABLE_START_TIME=stamp(600), USEABLE_STOP_TIME=stamp(60)),
            "USEABLE_START_TIME and USEABLE_STOP_TIME leave none of its time",
        ),
        (whole.replace("META_STOP", ""), "has META_START without META_STOP"),
        (whole.replace("OBJECT_NAME = A", "OBJECT_NAME"), "has the line 'OBJECT_NAME'; expected"),
        (whole.partition("META_START")[0], "has 0 values of OBJECT_ID; expected one"),
        (whole.partition("META_STOP")[0] + "META_STOP\n", "has a segment without states"),
        (
            whole + message(rows, OBJECT_ID="B").partition("ORIGINATOR = X\n")[2],
            "has 2 values of OBJECT_ID; expected one",
        ),
    ):
        with pytest.raises(InputError) as error:
            ephemeris_from(text, "a.oem")
        assert words in str(error.value)
        assert str(error.value).startswith("a.oem ") and "\n" not in str(error.value)


def test_too_few_states_for_the_degree_are_refused(rows):
    made = ephemeris_from(message(rows[:3]), "a.oem")
    with pytest.raises(InputError, match="enough states for its degree"):
        made.state_at(EPOCH, 10.0)
