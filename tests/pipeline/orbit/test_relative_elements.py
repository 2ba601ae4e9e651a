"""Rings about any orbit: how far an integrator finds that they drift, and what is said of it."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from relative import axes, pull
from scipy.integrate import solve_ivp

from pipeline.flight.world import NonlinearWorld
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import J2, MU_EARTH, R_EARTH
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.rings import pro_states, ring_states, secular_drift
from pipeline.scenario import Scenario, diagnostics

LEO = R_EARTH + 500e3
REVOLUTIONS, LOOKS = 5, 240
PHASES = 0.3 + np.pi / 2 * np.arange(4)
WIDE = 300.0, np.radians(45.0), PHASES, 0.7, 50.0
"""As large and as tilted as any ring that is drawn."""


def about(e, i, j2=True, u=77.0):
    given = {"inclination_deg": i, "argument_of_perigee_deg": 90.0, "argument_of_latitude_deg": u}
    orbit = ReferenceOrbit.of_mean(semi_major_axis=LEO / (1 - e), eccentricity=e, j2=j2, **given)
    return Problem().about(orbit)


def integrated(problem, states):
    """Along-track and cross-track positions over revolutions between nodes, (n, 5, looks)."""
    force = partial(pull, j2=problem.orbit.j2)
    origin = problem.orbit.states(np.zeros(1))[0]
    turn = axes(origin)
    h, r = np.cross(origin[:3], origin[3:]), np.linalg.norm(origin[:3])
    across = turn[:, 2] @ force(origin)
    rate = turn @ [r * across / np.linalg.norm(h), 0.0, np.linalg.norm(h) / r**2]
    position = states[:, :3] @ turn.T
    velocity = states[:, 3:] @ turn.T + np.cross(rate, position)
    begin = np.vstack([np.zeros(6), np.hstack([position, velocity])]) + origin

    def motion(_, flat):
        both = flat.reshape(-1, 6)
        return np.hstack([both[:, 3:], force(both)]).ravel()

    def northward(_, flat):
        return flat[2]

    northward.direction = 1
    length = 2 * np.pi / problem.mean_motion
    found = solve_ivp(
        motion,
        (0.0, (REVOLUTIONS + 1.1) * length),
        begin.ravel(),
        method="DOP853",
        rtol=1e-12,
        atol=1e-8,
        events=northward,
        dense_output=True,
    )
    if np.abs(begin[0, [2, 5]]).max() > 1.0:  # an orbit with a node
        length = np.diff(found.t_events[0]).mean()
    times = length / LOOKS * np.arange(REVOLUTIONS * LOOKS)
    flown = found.sol(times).T.reshape(len(times), -1, 6)
    relative = np.einsum("tji,tnj->nti", axes(flown[:, 0]), (flown[:, 1:] - flown[:, :1])[..., :3])
    return relative.reshape(len(states), REVOLUTIONS, LOOKS, 3)


def drift(problem, states):
    """Along-track, m a revolution: the slope of its averages over revolutions."""
    average = integrated(problem, states)[..., 1].mean(axis=2)
    return np.polyfit(np.arange(REVOLUTIONS), average.T, 1)[0]


@pytest.mark.parametrize(
    ("e", "i", "most"),
    [
        *((e, i, 0.01) for e in (0.0, 0.001, 0.01) for i in (97.4, 51.6)),
        (0.001, 0.0, 0.01),
        (0.1, 97.4, 0.01),
        (0.5, 51.6, 0.01),
    ],
)
def test_rings_under_j2_drift_by_less_than_a_centimetre_an_orbit(e, i, most):
    """A ring by Clohessy and Wiltshire drifts by metres, and the drift that is said is that."""
    problem = about(e, i)
    ring = ring_states(problem, *WIDE)
    size, tilt, phase, cross, offset = WIDE
    other = pro_states(size, tilt, phase, cross, problem.mean_motion, offset)
    of_ring, seen = np.split(drift(problem, np.concatenate([ring, other])), 2)
    assert np.abs(of_ring).max() < most
    assert np.abs(secular_drift(ring, problem)).max() < 1e-4
    assert np.abs(seen).max() > 0.5
    np.testing.assert_allclose(secular_drift(other, problem), seen, rtol=5e-3, atol=0.02)


@pytest.mark.parametrize("e", [0.0, 0.001, 0.1, 0.5])
def test_without_j2_rings_close(e):
    """Positions come back after every revolution, since all semi-major axes are the same."""
    problem = about(e, 51.6, j2=False)
    ring = ring_states(problem, *WIDE)
    track = integrated(problem, ring)
    np.testing.assert_allclose(track[:, 1:], track[:, :-1], atol=1e-4)
    assert np.abs(secular_drift(ring, problem)).max() < 1e-5


def test_about_a_circle_without_j2_rings_are_those_of_clohessy_and_wiltshire():
    size, tilt, phase, cross, offset = WIDE
    wanted = pro_states(size, tilt, phase, cross, Problem().mean_motion, offset)
    np.testing.assert_array_equal(ring_states(Problem(), *WIDE), wanted)
    curved = 300.0**2 / LEO
    for e in (0.0, 1e-9):
        problem = Problem().about(ReferenceOrbit(LEO, e, 51.6, j2=False))
        wanted = pro_states(size, tilt, phase, cross, problem.mean_motion, offset)
        np.testing.assert_allclose(ring_states(problem, *WIDE), wanted, atol=3 * curved)
        small = ring_states(problem, 3.0, *WIDE[1:4], 0.5)
        np.testing.assert_allclose(100 * small, wanted, atol=3 * curved / 100)


def test_drag_leaves_rings_what_they_are():
    """That of the reference, which all craft have in common."""
    problem = about(0.001, 97.4)
    dragged = problem.about(replace(problem.orbit, ballistic=0.01))
    np.testing.assert_allclose(ring_states(dragged, *WIDE), ring_states(problem, *WIDE), atol=1e-6)


def test_craft_that_leave_the_orbit_are_said_to_drift_far():
    problem = about(0.001, 97.4)
    states = np.zeros((3, 6))
    states[:, 4] = [0.0, 4000.0, -5000.0]
    still, away, down = secular_drift(states, problem)
    assert abs(still) < 1e-6
    assert away < -LEO < LEO < down


def test_check_says_by_how_much_each_end_drifts_and_the_cure_stops_it():
    problem = about(0.001, 97.4)
    later = problem.starting_at(problem.intervals)
    ends = ring_states(problem, *WIDE), ring_states(later, *WIDE)
    found = {(one.end, one.rule): one for one in diagnostics(Scenario(problem, *ends))}
    assert found["initial", "energy-matched"].fine and found["goal", "energy-matched"].fine
    moved = ends[1] + [0, 0, 0, 0, 0.002, 0]
    found = diagnostics(Scenario(problem, ends[0], moved))
    (wrong,) = [one for one in found if one.rule == "energy-matched" and not one.fine]
    assert (wrong.end, len(wrong.cases)) == ("goal", 4)
    seen = drift(later, moved)
    cured = moved.copy()
    for case in wrong.cases:
        (k,) = case.craft
        assert case.numbers["drift_per_orbit"] == pytest.approx(seen[k], rel=0.01)
        cured[k, 4] = case.numbers["vy_wanted"]
    assert np.abs(drift(later, cured)).max() < 0.05


def test_rings_are_where_the_nonlinear_flight_takes_them():
    """A ring flown for the transfer's time is the ring with phases that much later."""
    problem = about(0.001, 97.4)
    ring, idle = ring_states(problem, *WIDE), np.zeros((4, 3))
    world = NonlinearWorld.of(problem, 4)
    flown = ring
    for k in range(problem.intervals):
        flown = world.arc(flown, idle, k)[:, -1, -1]
    size, tilt, phase, cross, offset = WIDE
    later = problem.starting_at(problem.intervals)
    mean_motion = (MU_EARTH / problem.orbit.mean_elements.semi_major_axis**3) ** 0.5
    passed = mean_motion * problem.duration
    wanted = ring_states(later, size, tilt, phase + passed, cross, offset)
    turned = 2 * np.pi * 1.5 * J2 * 0.2 * 300  # at most, in a fifth of a revolution
    assert np.abs(flown - wanted)[:, :3].max() < turned
