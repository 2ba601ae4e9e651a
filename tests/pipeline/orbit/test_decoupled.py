"""Own optima by table: what a linear program finds, and a dual that proves it."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from pipeline.orbit.decoupled import facets_of, minimum_fuel_by_table
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly, transfer_maps

PERIOD = 2 * np.pi / Problem().mean_motion

PROBLEMS = {
    "reference": Problem(),
    "two intervals": Problem(nodes=3),
    "fine grid": Problem(time_step=20.0, nodes=61),
    "an orbit": Problem(time_step=PERIOD / 10),
    "two orbits": Problem(time_step=PERIOD / 10, nodes=21),
    "geostationary": Problem(mean_motion=7.29e-5, time_step=300.0, nodes=13),
}


def changes(problem, seed, count=40):
    """Changes of state that transfers of some 100 m bring about."""
    size = np.repeat([100.0, 100.0 / problem.duration], 3)
    return np.random.default_rng(seed).normal(size=(count, 6)) * size


def by_program(miss, problem):
    """Least ‖u‖₁ by HiGHS' interior points; the table is built by geometry alone."""
    reach = transfer_maps(problem).reach[-1]
    scale = 1 / np.linalg.norm(reach, axis=1)
    block = reach * scale[:, None]
    cost, equal = np.ones(2 * reach.shape[1]), np.hstack([block, -block])
    unit = np.abs(np.linalg.pinv(block) @ (miss * scale)).max()
    found = linprog(cost, A_eq=equal, b_eq=miss * scale / unit, method="highs-ipm")
    assert found.status == 0
    return found.fun * unit


@pytest.mark.parametrize("problem", PROBLEMS.values(), ids=PROBLEMS)
def test_fuel_is_that_of_the_linear_program_and_the_goal_is_met(problem):
    miss = changes(problem, 0)
    found = minimum_fuel_by_table(miss, problem)
    exact = np.array([by_program(one, problem) for one in miss])
    fuel = np.abs(found.controls).sum(axis=(1, 2))
    assert found.exact.all()
    assert found.bound == pytest.approx(exact, rel=1e-6)
    assert fuel == pytest.approx(found.bound, rel=1e-9)
    final = fly(np.zeros((len(miss), 6)), found.controls, problem)[:, -1]
    assert final == pytest.approx(miss, rel=1e-9, abs=1e-9 * np.abs(miss).max())


@pytest.mark.parametrize("problem", PROBLEMS.values(), ids=PROBLEMS)
def test_the_dual_proves_the_bound(problem):
    """Weak duality: with |reachᵀy| ≤ 1 no controls need less than missᵀy."""
    miss = changes(problem, 1)
    dual = np.zeros(miss.shape)
    for facets in facets_of(problem):
        value = miss[:, facets.component] @ facets.dual.T
        dual[:, facets.component] = facets.dual[value.argmax(axis=1)]
    price = dual @ transfer_maps(problem).reach[-1]
    assert np.abs(price).max() <= 1 + 1e-12
    assert (dual * miss).sum(axis=1) == pytest.approx(
        minimum_fuel_by_table(miss, problem).bound, rel=1e-12
    )


def test_the_basis_is_what_is_used_in_its_direction():
    problem = Problem()
    found = minimum_fuel_by_table(changes(problem, 2), problem)
    for controls, basis in zip(found.controls.reshape(40, -1), found.basis, strict=True):
        used = np.flatnonzero(controls)
        named = dict(zip(basis % 30, np.where(basis < 30, 1, -1), strict=True))
        assert set(used) <= set(named)
        assert all(np.sign(controls[k]) == named[k] for k in used)


@settings(max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.integers(0, 5), min_size=1, max_size=3, unique=True),
    st.sampled_from(list(PROBLEMS.values())),
)
def test_what_lies_between_facets_is_met_too(seed, columns, problem):
    """Few thrusters' worth: on an edge of the hull, where many facets are equally good."""
    reach = transfer_maps(problem).reach[-1]
    rng = np.random.default_rng(seed)
    hull = facets_of(problem)[0]
    facet = int(rng.integers(len(hull.column)))
    corner = hull.column[facet][[c % hull.column.shape[1] for c in columns]]
    burn = np.zeros(reach.shape[1])
    burn[corner] = 1e-3 * hull.sign[facet][[c % hull.column.shape[1] for c in columns]]
    found = minimum_fuel_by_table((reach @ burn)[None], problem)
    assert found.exact.all()
    assert found.bound[0] == pytest.approx(np.abs(burn).sum(), rel=1e-7)


def test_nothing_to_change_needs_no_fuel():
    found = minimum_fuel_by_table(np.zeros((2, 6)), Problem())
    assert (found.controls == 0).all() and (found.bound == 0).all() and found.exact.all()


def test_where_a_state_is_out_of_reach_there_is_no_table():
    """Half an orbit apart, both cross-track thrusts move a craft along the same line."""
    stuck = Problem(time_step=PERIOD / 2, nodes=3)
    assert facets_of(stuck) is None
    assert minimum_fuel_by_table(np.ones((1, 6)), stuck) is None


def test_where_all_facets_are_flat_there_is_no_table():
    day = 2 * np.pi / (mean_motion := 7.29e-5)
    nearly = Problem(mean_motion=mean_motion, time_step=day / 2 + 1e-7, nodes=3)
    assert facets_of(nearly) is None
    assert minimum_fuel_by_table(np.ones((1, 6)), nearly) is None


def test_a_table_is_made_once():
    problem = replace(Problem(), time_step=77.0)
    assert facets_of(problem) is facets_of(replace(problem))


def test_a_table_of_many_facets_takes_little_memory():
    """An orbit in 200 intervals: 18,000 facets, and 400 controls whose effects are compared."""
    problem = Problem(time_step=PERIOD / 200, nodes=201)
    transfer_maps(problem)
    tracemalloc.start()
    (in_plane, _) = facets_of(problem)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(in_plane.dual) > 10_000
    assert peak < 30e6
