"""Encounters against trajectories sampled finely by the problem's own dynamics."""

import numpy as np
import pytest
import torch

from pipeline.networks.refiner.encounters import (
    Encounters,
    approach,
    candidates,
    directions,
    look,
    plane_rows,
)
from pipeline.networks.refiner.grid import grid_of, in_units
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly, minimum_energy, track
from pipeline.scenario import draw

PROBLEM, N, STEPS = Problem(), 8, 400
RADIUS, STEP = PROBLEM.collision_radius, PROBLEM.time_step
SCENARIOS = [draw("rings", 0, N, k, PROBLEM, "valid") for k in range(3)]
INITIAL = np.concatenate([s.initial for s in SCENARIOS])
CONTROLS = minimum_energy(INITIAL, np.concatenate([s.goal for s in SCENARIOS]), PROBLEM)
STATES = fly(INITIAL, CONTROLS, PROBLEM)
SCALED = in_units(
    torch.from_numpy(STATES), torch.full((len(STATES),), RADIUS, dtype=torch.float64), PROBLEM
).reshape(STATES.shape)


def sampled():
    """Distance of all pairs at all sampled times, by interval, in r_col."""
    fine = track(STATES, CONTROLS, PROBLEM, STEPS)
    gap = np.linalg.norm(fine[:, None] - fine[None], axis=3) / RADIUS
    ends = np.arange(PROBLEM.intervals)[:, None] * STEPS + np.arange(STEPS + 1)
    return gap[:, :, ends]  # (craft, craft, interval, sample)


def test_every_pair_and_interval_within_the_distance_is_found_and_no_other():
    least, within = sampled().min(axis=3), 5.0
    met = candidates(SCALED, N, within)
    found = {(int(i), int(j), int(k)) for i, j, k in zip(*vars(met).values(), strict=True)}
    swarm = np.arange(len(STATES)) // N
    wanted = {
        (i, j, k)
        for i, j, k in zip(*np.nonzero(least <= within), strict=True)
        if i < j and swarm[i] == swarm[j]
    }
    assert found == wanted
    assert len(found) > 20


def test_the_closest_approach_is_the_least_of_the_samples():
    met = candidates(SCALED, N, 5.0)
    seen = look(met, SCALED)
    found = approach(met.relative(SCALED), seen.share)
    assert found.distance.numpy() == pytest.approx(seen.distance.numpy(), abs=1e-12)
    distance = sampled()[met.first, met.second, met.interval]
    assert found.distance.numpy() == pytest.approx(distance.min(axis=1), abs=2e-4)
    when = distance.argmin(axis=1) / STEPS
    deep = np.ptp(distance, axis=1) > 0.1  # elsewhere there is no moment to speak of
    assert found.share.numpy()[deep] == pytest.approx(when[deep], abs=0.02)


def test_a_plane_s_row_gives_the_gap_along_its_normal():
    met = candidates(SCALED, N, 5.0)
    found = approach(met.relative(SCALED), look(met, SCALED).share)
    along, motion, across = directions(found)
    for normal in (along, motion, across):
        row = plane_rows(met, found.share, normal, PROBLEM.nodes)
        flat = SCALED.reshape(len(STATES), -1)
        gap = (row * (flat[met.first] - flat[met.second])).sum(dim=1)
        assert gap.numpy() == pytest.approx((found.gap * normal).sum(dim=1).numpy(), abs=1e-9)
    grid = grid_of(PROBLEM, torch.device("cpu"))
    assert grid.nodes == PROBLEM.nodes


def test_directions_are_orthogonal_even_where_craft_touch_or_stand_still():
    ends = torch.zeros(3, 2, 6, dtype=torch.float64)
    ends[0, :, 3:] = torch.tensor([1.0, 2.0, 3.0])  # touches, moving
    ends[0, 0, :3], ends[0, 1, :3] = -0.5 * ends[0, 0, 3:], 0.5 * ends[0, 0, 3:]
    ends[1, :, 0] = 2.0  # stands still
    ends[2] = torch.randn(2, 6)
    found = approach(ends, torch.full((3,), 0.5, dtype=torch.float64))
    three = torch.stack(directions(found), dim=1)
    eye = torch.eye(3, dtype=torch.float64).expand(3, 3, 3)
    assert (three @ three.mT).numpy() == pytest.approx(eye.numpy(), abs=1e-9)
    assert found.distance[0] == pytest.approx(0.0, abs=1e-9)
    assert found.distance[1] == pytest.approx(2.0)


def test_the_closest_approach_of_any_cubic_is_found():
    """Random motion with strong bends, against ten thousand samples."""
    rng = np.random.default_rng(0)
    ends = rng.normal(size=(500, 2, 6)) * [1, 1, 1, 2, 2, 2]
    states = torch.from_numpy(np.stack([ends, np.zeros_like(ends)]).reshape(1000, 2, 6))
    pair = torch.arange(500)
    found = look(Encounters(pair, pair + 500, torch.zeros_like(pair)), states)
    s = np.linspace(0, 1, 10_001)[:, None, None]
    (p0, v0), (p1, v1) = (np.split(ends[:, k], 2, axis=1) for k in (0, 1))
    p = p0 + s * (v0 + s * (3 * (p1 - p0) - 2 * v0 - v1 + s * (2 * (p0 - p1) + v0 + v1)))
    least = np.linalg.norm(p, axis=2).min(axis=0)
    error = found.distance.numpy() - least
    assert error.min() > -1e-6
    assert np.quantile(error, 0.99) < 1e-4
    assert error.max() < 0.01
