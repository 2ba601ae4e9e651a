"""The compiled search for closest points, held against roots of polynomials and maps of motion."""

import shutil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.arrays import CompiledLibrary
from pipeline.errors import ProlearnError
from pipeline.orbit import closest
from pipeline.orbit.dynamics import ClohessyWiltshire
from pipeline.orbit.linearized import LinearizedDynamics
from pipeline.orbit.reference_orbit import ReferenceOrbit

H, TOLERANCE = 100.0, 1e-4
MOLNIYA = ReferenceOrbit(26.6e6, 0.7, 63.4, argument_of_latitude_deg=-30.0)
DYNAMICS = {
    "a circle": ClohessyWiltshire(1.1e-3, 120.0),
    "no orbit": ClohessyWiltshire(1e-12, 120.0),
    "two orbits at once": ClohessyWiltshire(1.1e-3, 12_000.0),
    "an ellipse": LinearizedDynamics(MOLNIYA, 300.0, 4),
    "half of an ellipse at once": LinearizedDynamics(MOLNIYA, 20_000.0, 4),
}


def nearest_of(begin, end):
    """Least distance of cubics with the states of both ends, by the roots of its derivative."""
    (p, v), (q, w) = begin.reshape(2, 3), end.reshape(2, 3)
    v, w = H * v, H * w
    cubic = [
        np.poly1d(c) for c in np.transpose([2 * (p - q) + v + w, 3 * (q - p) - 2 * v - w, v, p])
    ]
    squared = sum((c * c for c in cubic), np.poly1d([0.0]))
    roots = squared.deriv().roots
    at = np.clip([0.0, 1.0, *roots[abs(roots.imag) < 1e-6].real], 0.0, 1.0)
    return float(np.sqrt(max(0.0, squared(at).min())))


@given(seed=st.integers(0, 10_000), speed=st.sampled_from([0.01, 1.0, 10.0]))
def test_the_least_distance_of_cubics_is_that_by_roots(seed, speed):
    """Nearly straight ones and loops; with a remainder, which lowers bounds alone."""
    rng = np.random.default_rng(seed)
    ends = rng.normal(size=(2, 20, 6)) * np.repeat([50.0, speed], 3)
    true = np.array([nearest_of(*each) for each in ends.swapaxes(0, 1)])
    far, off = np.full(20, np.inf), np.full(20, 0.5)
    for remainder in (0 * off, off):
        _, distance, bound = closest.closest_of_cubics(
            tuple(ends), H, None, remainder, far, TOLERANCE
        )
        assert (distance >= true - 1e-9).all()
        assert (bound <= true - remainder + 1e-9).all()
        assert (bound >= distance - 2 * remainder - TOLERANCE - 1e-9).all()
    reach = np.median(true)
    _, _, some = closest.closest_of_cubics(
        tuple(ends), H, None, 0 * off, np.full(20, reach), TOLERANCE
    )
    assert (some[true > reach + 2 * TOLERANCE] > reach).all()
    near = true < reach - 2 * TOLERANCE
    assert some[near] == pytest.approx(true[near], abs=1.01 * TOLERANCE)


def test_scaled_axes_are_those_in_which_distances_count():
    rng = np.random.default_rng(0)
    ends, scale = rng.normal(size=(2, 20, 6)), rng.uniform(0.2, 1.0, size=(20, 3))
    none, far = np.zeros(20), np.full(20, np.inf)
    scaled = tuple(ends * np.tile(scale, 2))
    one = closest.closest_of_cubics(tuple(ends), H, scale, none, far, TOLERANCE)
    other = closest.closest_of_cubics(scaled, H, None, none, far, TOLERANCE)
    np.testing.assert_allclose(one, other, rtol=1e-6)


@pytest.mark.parametrize("name", DYNAMICS)
def test_what_is_found_is_where_the_motion_is_then_whatever_is_searched_beside(name):
    dynamics, rng = DYNAMICS[name], np.random.default_rng(0)
    h, k = dynamics.time_step, 30
    rate = max(dynamics.fastest, 1 / h)
    motions = rng.normal(size=(k, 9)) * np.repeat([50.0, 50.0 * rate, 10.0 * rate**2], 3)
    interval = np.sort(rng.integers(0, 4, size=k))
    linear, far = dynamics.linear_motion(interval), np.full(k, np.inf)
    found = closest.closest_of_motions(linear, motions, interval, h, None, far, TOLERANCE)
    assert found["index"].tolist() == list(range(k))
    A, B = dynamics.step(found["offset"], interval)
    largest = np.abs(A).max(), np.abs(B).max()
    np.testing.assert_allclose(found["state_map"], A[:, :3], atol=1e-12 * largest[0])
    np.testing.assert_allclose(found["control_map"], B[:, :3], atol=1e-12 * largest[1])
    there = np.matvec(A[:, :3], motions[:, :6]) + np.matvec(B[:, :3], motions[:, 6:])
    assert found["distance"] == pytest.approx(np.linalg.norm(there, axis=1), abs=1.01 * TOLERANCE)
    assert (found["bound"] <= found["distance"]).all()
    assert (found["bound"] >= found["distance"] - TOLERANCE - 1e-9).all()
    times = h * np.linspace(0, 1, 2000)[:, None]
    A, B = (maps[..., :3, :] for maps in dynamics.step(times, interval))
    sampled = np.linalg.norm(np.matvec(A, motions[:, :6]) + np.matvec(B, motions[:, 6:]), axis=-1)
    assert (found["bound"] <= sampled.min(axis=0) + 1e-9).all()
    for each in range(k):
        alone = slice(each, each + 1)
        given = linear, motions[alone], interval[alone], h, None, far[alone], TOLERANCE
        same = closest.closest_of_motions(*given)
        same["index"] += each
        assert same.tobytes() == found[alone].tobytes()


def test_motion_too_wild_to_be_searched_is_bounded_by_zero_and_what_is_no_number_left_out():
    linear, far = DYNAMICS["a circle"].linear_motion(0), np.full(3, np.inf)
    wild = np.array([[1.0] * 9, [1e60] * 9, [np.nan] * 9])
    found = closest.closest_of_motions(linear, wild, np.zeros(3, int), H, None, far, TOLERANCE)
    assert found["index"].tolist() == [0, 1]
    assert found["bound"][1] == 0.0


@pytest.mark.parametrize("what", ["missing", "of an earlier source"])
def test_a_library_that_does_not_fit_its_source_is_refused_in_a_sentence(what, tmp_path):
    """Beside a source without a library, or with the one of another source."""
    library, source = closest.LIBRARY, tmp_path / "closest.c"
    source.write_bytes(library.source.read_bytes() + b"\n")
    if what == "of an earlier source":
        shutil.copy(library.source.with_name("libclosest.so"), tmp_path)
    with pytest.raises(ProlearnError, match=r"earlier closest\.c; expected what an installation"):
        CompiledLibrary(source, library.functions).call("pairs_within")
