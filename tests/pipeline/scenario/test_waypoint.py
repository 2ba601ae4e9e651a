"""Waypoints: who must be closest at one time, of few craft and of many."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

from pipeline.orbit.problem import Problem
from pipeline.scenario.waypoint import Waypoint, closest_pair

PROBLEM = Problem()


@pytest.mark.parametrize("n", [2, 7, 2000])
def test_the_pair_that_must_be_closest_is_that_of_scipy_s_distances(n):
    """By what is left between spheres, at either of two times; 2000 craft take a moment."""
    rng = np.random.default_rng(n)
    radii, least = rng.uniform(1, 30, n), []
    waypoints = []
    for time in (240.0, 960.0):
        places = rng.uniform(-1e4, 1e4, (n, 3))
        waypoints += [
            Waypoint(k, tuple(place), None, time) for k, place in enumerate(places.tolist())
        ]
        left = squareform(pdist(places)) - radii - radii[:, None]
        np.fill_diagonal(left, np.inf)
        least.append((left.min(), sorted(divmod(int(left.argmin()), n)), time))
    distance, i, j, time = closest_pair([*waypoints, Waypoint(0, (0.0, 0.0, 0.0))], PROBLEM, radii)
    assert distance - radii[i] - radii[j] == pytest.approx(min(least)[0])
    assert ([i, j], time) == min(least)[1:]


def test_one_waypoint_a_time_has_no_pair():
    alone = [Waypoint(0, (0.0, 0.0, 0.0), None, 240.0), Waypoint(1, (0.0, 0.0, 0.0), None, 360.0)]
    assert closest_pair(alone, PROBLEM, np.full(2, 7.5)) is None
