"""Who takes which goal: against every permutation, with each pair's fuel by scipy's linprog."""

import tracemalloc
from itertools import islice, permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from judge import Case, least_fuel
from judged import document
from scipy.optimize import linear_sum_assignment

from pipeline.orbit.problem import Problem
from pipeline.planners.goal_assignment import decoupled_costs, ranked
from pipeline.scenario import draw


def every_order(scenario):
    """The least fuel of each order of the goals, by one linear program a craft and goal."""
    case, n = Case.of(document(scenario)), scenario.n
    costs = np.stack(
        [least_fuel(case, scenario.initial, scenario.goal[[j] * n]).attained for j in range(n)], 1
    )
    return {order: costs[range(n), order].sum() for order in permutations(range(n))}


@pytest.mark.parametrize(("n", "index"), [(4, 0), (4, 1), (5, 2)])
@pytest.mark.parametrize("limit", [None, 1.5e-3, 7e-4])
def test_the_first_assignment_is_the_cheapest_of_all_permutations(n, index, limit):
    scenario = draw("rings", 5, n, index, Problem(max_acceleration=limit), "valid")
    truth = every_order(scenario)
    costs = decoupled_costs(scenario)
    first = next(ranked(costs.fuel), None)
    if np.isinf(min(truth.values())):
        assert first is None
        return
    assert costs.of(first) == pytest.approx(min(truth.values()), rel=1e-6)
    assert costs.of(first) <= min(truth.values()) * (1 + 1e-9), "it is a bound"
    assert truth[first] == pytest.approx(min(truth.values()), rel=1e-6)
    given_order = tuple(range(n))
    assert costs.of(given_order) == pytest.approx(truth[given_order], rel=1e-6)
    for order, fuel in truth.items():
        assert costs.of(order) <= fuel * (1 + 1e-6), "no cost is above the truth"


def test_a_thrust_limit_changes_who_goes_where():
    """The cheapest assignment breaks the limit, and the cheapest that keeps to it is another."""
    found = 0
    for index in range(8):
        free = draw("independent", 5, 4, index, Problem(), "valid")
        limited = draw("independent", 5, 4, index, Problem(max_acceleration=8e-4), "valid")
        truth = every_order(limited)
        first = next(ranked(decoupled_costs(limited).fuel), None)
        if first is None:
            assert np.isinf(min(truth.values()))
            continue
        assert truth[first] == pytest.approx(min(truth.values()), rel=1e-6)
        found += first != next(ranked(decoupled_costs(free).fuel))
    assert found


COSTS = st.integers(1, 5).flatmap(
    lambda n: st.lists(st.sampled_from([0.0, 1, 2, 3.5, 7, np.inf]), min_size=n * n, max_size=n * n)
)


@settings(max_examples=100)
@given(COSTS)
def test_assignments_come_each_once_by_their_cost(entries):
    n = round(len(entries) ** 0.5)
    costs = np.reshape(np.array(entries, dtype=float), (n, n))
    truth = {order: costs[range(n), order].sum() for order in permutations(range(n))}
    possible = {order: cost for order, cost in truth.items() if np.isfinite(cost)}
    found = list(ranked(costs))
    assert len(found) == len(set(found)) and set(found) == possible.keys()
    assert [possible[order] for order in found] == sorted(possible.values())


def test_the_best_of_three_hundred_are_found_in_little_memory():
    """Distances of random points: their order, and the memory of a few matrices of their size."""
    rng = np.random.default_rng(0)
    here, there = rng.normal(size=(2, 300, 3))
    costs = np.linalg.norm(here[:, None] - there[None], axis=-1)
    tracemalloc.start()
    found = list(islice(ranked(costs), 8))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 40 * costs.nbytes
    paid = [costs[range(300), slots].sum() for slots in found]
    assert paid == sorted(paid) and len(set(found)) == 8
    assert paid[0] == costs[linear_sum_assignment(costs)].sum()
    # No two craft of the best that swap their goals come before the last that was found.
    i, j = np.triu_indices(300, 1)
    one, other = (np.array(found[0])[k] for k in (i, j))
    swaps = costs[i, other] + costs[j, one] - costs[i, one] - costs[j, other]
    cheap = paid[0] + swaps[paid[0] + swaps < paid[-1] - 1e-9]
    assert np.isclose(cheap[:, None], paid, rtol=1e-12).any(axis=1).all()
