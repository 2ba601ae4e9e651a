"""Encounters against trajectories sampled finely by the problem's own dynamics."""

import subprocess
import sys
from functools import cache

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from pipeline.networks.refiner import geometry
from pipeline.networks.refiner.geometry import (
    EncounterGeometry,
    Encounters,
    encounters,
    in_units,
)
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly, minimum_energy, track
from pipeline.scenario import draw

PROBLEM, N, STEPS = Problem(), 8, 400
RADIUS, STEP = PROBLEM.collision_radius, PROBLEM.time_step
SCENARIOS = [draw("rings", 0, N, k, PROBLEM, "valid") for k in range(3)]
INITIAL = np.concatenate([s.initial for s in SCENARIOS])
CONTROLS = minimum_energy(INITIAL, np.concatenate([s.goal for s in SCENARIOS]), PROBLEM)
STATES = fly(INITIAL, CONTROLS, PROBLEM)
SCALED = in_units(STATES, np.full(len(STATES), RADIUS), PROBLEM).reshape(STATES.shape)


@pytest.fixture
def within(monkeypatch):
    """Encounters of swarms of n craft within a distance, or a share of their extent."""

    def found(states, n, near, of_extent=0.0):
        monkeypatch.setattr(geometry, "NEAR", near)
        monkeypatch.setattr(geometry, "NEAR_OF_EXTENT", of_extent)
        return encounters(states, n)

    return found


@cache
def sampled():
    """Distance of all pairs at all sampled times, by interval, in r_col."""
    fine = track(STATES, CONTROLS, PROBLEM, STEPS)
    gap = np.linalg.norm(fine[:, None] - fine[None], axis=3) / RADIUS
    ends = np.arange(PROBLEM.intervals)[:, None] * STEPS + np.arange(STEPS + 1)
    return gap[:, :, ends]  # (craft, craft, interval, sample)


def pairs_of(ends):
    """Each of some relative motions as an encounter with a craft that rests at 0."""
    both = np.concatenate([ends, np.zeros_like(ends)])
    pair = np.arange(len(ends))
    return Encounters(pair, pair + len(ends), np.zeros_like(pair)), both


def approaches(met, states, within=np.inf):
    """The closest approach of every encounter, however far, or within a distance."""
    within = np.full(len(met), within)
    unseen = EncounterGeometry(within, within, within > 0)
    return met.approaches(states, within, unseen, np.ones(len(states), dtype=bool))


def test_every_pair_and_interval_within_the_distance_is_found_and_no_other(within):
    least, near = sampled().min(axis=3), 5.0
    met = within(SCALED, N, near)
    found = {(int(i), int(j), int(k)) for i, j, k in zip(*vars(met).values(), strict=True)}
    swarm = np.arange(len(STATES)) // N
    wanted = {
        (i, j, k)
        for i, j, k in zip(*np.nonzero(least <= near), strict=True)
        if i < j and swarm[i] == swarm[j]
    }
    assert found == wanted
    assert len(found) > 20


def test_the_closest_approach_is_the_least_of_the_samples(within):
    met = within(SCALED, N, 5.0)
    found = approaches(met, SCALED)
    distance = sampled()[met.first, met.second, met.interval]
    assert found.distance == pytest.approx(distance.min(axis=1), abs=2e-4)
    when = distance.argmin(axis=1) / STEPS
    deep = np.ptp(distance, axis=1) > 0.1  # elsewhere there is no moment to speak of
    assert found.share[deep] == pytest.approx(when[deep], abs=0.02)


def test_fast_passes_are_found_as_well():
    """Motion of 100 r_col an interval, past each other at about 1, as scipy's cubics have it."""
    rng = np.random.default_rng(0)
    speed = 100 * rng.normal(size=(200, 1, 3)) / np.sqrt(3)
    turn = 30 * rng.normal(size=(200, 2, 3))
    miss, when = rng.normal(size=(200, 1, 3)), rng.uniform(0, 1, size=(200, 1, 1))
    ends = np.concatenate([miss + (np.array([[[0.0], [1.0]]]) - when) * speed, speed + turn], 2)
    met, states = pairs_of(ends)
    found = approaches(met, states)
    motion = CubicHermiteSpline([0, 1], ends[..., :3], ends[..., 3:], axis=1)
    place = motion(np.linspace(0, 1, 40_001))
    least = np.sqrt(np.vecdot(place, place).min(axis=1))
    assert found.distance == pytest.approx(least, abs=2e-3)


def test_who_is_sure_to_stay_beyond_a_distance_is_not_looked_at_and_nobody_else():
    """Random motion about a distance of 3: what is seen is exact, what is not is beyond 2."""
    rng = np.random.default_rng(1)
    ends = rng.normal(size=(3000, 2, 6)) * [2, 2, 2, 1, 1, 1]
    met, states = pairs_of(ends)
    every = approaches(met, states)
    some = approaches(met, states, 2.0)
    unseen = np.isinf(some.distance)
    assert (every.distance[unseen] > 2).all()
    assert np.array_equal(some.distance[~unseen], every.distance[~unseen])
    assert np.array_equal(some.share[~unseen], every.share[~unseen])
    assert unseen.sum() > 0.5 * (every.distance > 2).sum() > 500


def test_all_pairs_of_a_large_swarm_are_looked_at_in_bounded_memory():
    """A line of craft 40 r_col apart, of which neighbours alone come within 41."""
    n = 1000
    code = f"""if True:
        import resource
        import numpy as np
        from pipeline.networks.refiner import geometry
        geometry.NEAR, geometry.NEAR_OF_EXTENT = 41.0, 0.0
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        states = np.zeros(({n}, 11, 6))
        states[..., 0] = 40.0 * np.arange({n})[:, None]
        met = geometry.encounters(states, {n})
        more = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        print(len(met.first), more // 1024)
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    found, megabytes = map(int, done.stdout.split())
    assert found == (n - 1) * 10
    assert megabytes < 250  # comparing all at once would take over 500 MB


def test_a_wide_swarm_is_looked_at_further_out_than_a_narrow_one_beside_it(within):
    both = np.concatenate([SCALED[:N], 4 * SCALED[N : 2 * N]])
    extent = [float(np.ptp(x[..., :3], axis=(0, 1)).max()) / 2 for x in np.split(both, 2)]
    met = within(both, N, 5.0, 0.3)
    for k, one in enumerate(np.split(both, 2)):
        alone = within(one, N, max(5.0, 0.3 * extent[k]))
        assert np.array_equal(met.first[met.first // N == k] - k * N, alone.first)


def test_the_closest_approach_of_any_cubic_is_found():
    """Random motion with strong bends, against ten thousand samples."""
    rng = np.random.default_rng(0)
    ends = rng.normal(size=(500, 2, 6)) * [1, 1, 1, 2, 2, 2]
    met, states = pairs_of(ends)
    found = approaches(met, states)
    s = np.linspace(0, 1, 10_001)[:, None, None]
    (p0, v0), (p1, v1) = (np.split(ends[:, k], 2, axis=1) for k in (0, 1))
    p = p0 + s * (v0 + s * (3 * (p1 - p0) - 2 * v0 - v1 + s * (2 * (p0 - p1) + v0 + v1)))
    least = np.sqrt(np.vecdot(p, p).min(axis=0))
    error = found.distance - least
    assert error.min() > -1e-6
    assert np.quantile(error, 0.99) < 1e-4
    assert error.max() < 0.01


def turning(x, speed):
    """Intervals in which a craft on the x axis turns from coming closer to 0 to parting from it."""
    states = np.zeros((2, len(x), 6))
    states[0, :, 0], states[0, :, 3] = x, speed
    each = np.arange(len(x) - 1)
    met = Encounters(np.zeros_like(each), np.ones_like(each), each)
    found = approaches(met, states)
    return each[found.is_minimum].tolist(), found


def test_a_pair_turns_in_the_intervals_in_which_its_distance_has_a_minimum():
    """A cosine that is least at 1.5, 5.5 and 9.5 intervals."""
    time = np.arange(11)
    phase = np.pi * (time - 3.5) / 2
    x, speed = 3 + 2 * np.cos(phase), -np.pi * np.sin(phase)
    intervals, found = turning(x, speed)
    fine = np.linspace(0, 10, 4001)
    distance = CubicHermiteSpline(time, x, speed)(fine)
    least = (distance[1:-1] < distance[:-2]) & (distance[1:-1] < distance[2:])
    assert intervals == np.floor(fine[1:-1][least]).tolist() == [1, 5, 9]
    assert found.share[intervals] == pytest.approx(0.5, abs=0.01)
    assert (found.distance[[0, 2, 4, 6, 8]] > 1.5).all()


def test_a_pair_that_turns_at_a_node_or_keeps_its_distance_turns_there():
    time = np.arange(11)
    intervals, _ = turning(1 + (time - 4.0) ** 2, 2 * (time - 4.0))
    assert intervals
    assert set(intervals) <= {3, 4}
    assert turning(np.full(11, 2.0), np.zeros(11))[0] == list(range(10))
