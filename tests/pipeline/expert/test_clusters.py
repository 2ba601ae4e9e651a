"""Clusters of the conflict graph, and subproblems of large ones with other craft fixed."""

import numpy as np
import pytest

from pipeline.expert import clusters, solve
from pipeline.expert.cuts import HalfSpaces, cuts_at
from pipeline.expert.solvers import by_simplex
from pipeline.expert.subproblem import UnsolvableError
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust import Thrust
from pipeline.plan.plan import SOLVED
from pipeline.plan.requirements import Requirements
from pipeline.scenario import draw

RNG = np.random.default_rng(5)


def chain(n):
    """Cuts between each craft and the next."""
    each = np.arange(n - 1)
    return cuts_at(each, each + 1, np.zeros_like(each), np.zeros(n - 1), Problem())


def test_parts_are_unsafe_craft_and_those_that_share_a_cut_with_one():
    unsafe = np.isin(np.arange(20), [4, 16])
    found = clusters.neighbourhoods(np.arange(20), chain(20), unsafe)
    assert [part.tolist() for part in found] == [[3, 4, 5], [15, 16, 17]]


@pytest.mark.parametrize("unsafe", [[], [0, 5, 10, 15]])
def test_a_cluster_is_solved_whole_where_none_or_most_of_it_is_unsafe(unsafe):
    marked = np.isin(np.arange(20), unsafe)
    assert clusters.neighbourhoods(np.arange(20), chain(20), marked) == []


def test_clusters_of_one_scenario_share_programs_of_at_most_so_many_craft(monkeypatch):
    monkeypatch.setattr(clusters, "JOINT", 5)
    swarm = np.repeat([0, 1], [12, 4])
    given = [[0, 3], [1, 2, 4], [5, 6, 7, 8, 9, 10], [11], [12, 14], [13, 15]]
    found = clusters.joint_clusters([np.array(craft) for craft in given], swarm)
    each = [[craft.tolist() for craft in some] for some in found]
    assert each == [given[:2], given[2:3], given[3:4], given[4:]]


@pytest.mark.parametrize("limit", [None, 3e-3])
def test_plans_by_joint_programs_cost_what_those_of_one_program_a_cluster_do(monkeypatch, limit):
    scenarios = [draw("rings", 4, 60, k, Problem(max_acceleration=limit)) for k in range(2)]
    joint = [solve(scenario) for scenario in scenarios]
    monkeypatch.setattr(clusters, "JOINT", 0)
    single = [solve(scenario) for scenario in scenarios]
    assert {plan.status for plan in (*joint, *single)} == {SOLVED}
    assert any((a.controls != b.controls).any() for a, b in zip(joint, single, strict=True))
    fuel = np.array([[plan.certificate.fuel for plan in plans] for plans in (joint, single)])
    # Rounding decides between programs' optima of equal cost, and these where a search ends.
    assert fuel[0] == pytest.approx(fuel[1], rel=1e-3)


def test_clusters_whose_joint_program_fails_are_solved_one_by_one(monkeypatch):
    scenario, sizes = draw("rings", 4, 60, 0, Problem()), []

    def solved(sub, most):
        if len(sub.miss) > most:
            raise UnsolvableError("too large")
        sizes.append(len(sub.miss))
        return by_simplex(sub)

    monkeypatch.setattr("pipeline.expert.scp.by_simplex", lambda sub: solved(sub, 60))
    with monkeypatch.context() as alone:
        alone.setattr(clusters, "JOINT", 0)
        single = solve(scenario)
    most = max(sizes)
    assert solve(scenario).status == single.status == SOLVED
    assert max(sizes) > most  # joint programs are larger
    monkeypatch.setattr("pipeline.expert.scp.by_simplex", lambda sub: solved(sub, most))
    plan = solve(scenario)
    assert plan.status == SOLVED
    assert plan.certificate.fuel == pytest.approx(single.certificate.fuel, rel=1e-3)


@pytest.mark.parametrize("alike", [True, False])
def test_half_spaces_about_some_craft_are_missed_by_as_much_as_those_about_all(alike):
    controls = RNG.normal(size=(6, 10, 3))
    pairs = np.array([(0, 1), (1, 2), (2, 3), (3, 4), (1, 2)])
    cuts = cuts_at(*pairs.T, np.zeros(5, dtype=int), np.zeros(5), Problem())
    row, other = RNG.normal(size=(2, 5, 30))
    other = row if alike else other
    planes = HalfSpaces(row, RNG.normal(size=5), None if alike else other)
    some, flat = np.array([1, 2, 4]), controls.reshape(6, 30)
    first, second, bound = clusters.with_others_fixed(some, cuts, planes, controls)
    mine = flat[some]
    margin = np.vecdot(row, flat[pairs[:, 0]]) - np.vecdot(other, flat[pairs[:, 1]])
    found = np.vecdot(bound.row, mine[first]) - np.vecdot(bound.other, mine[second])
    assert found - bound.required == pytest.approx(margin - planes.required, abs=1e-12)


@pytest.mark.parametrize(
    ("problem", "asked", "family", "n"),
    [
        (Problem(), Requirements(), "rings", 40),
        (Problem(), Requirements("nodes"), "rings", 40),
        (Problem(), Requirements(passive_safety=0.5), "rings", 24),
        (Problem(thrust=Thrust("norm")), Requirements(), "dense", 12),
    ],
    ids=["at all times", "at nodes", "passively safe", "norm"],
)
def test_plans_of_clusters_in_parts_are_safe_and_cost_what_whole_ones_do(
    monkeypatch, problem, asked, family, n
):
    scenarios = [draw(family, 3, n, index, problem) for index in range(2)]
    whole = [solve(scenario, requirements=asked) for scenario in scenarios]
    monkeypatch.setattr("pipeline.expert.scp.VAST", 4)
    monkeypatch.setattr(clusters, "HOPS", 0)
    parts = [solve(scenario, requirements=asked) for scenario in scenarios]
    assert any(
        (one.controls != other.controls).any() for one, other in zip(whole, parts, strict=True)
    )
    assert all(plan.status == SOLVED for plan in parts)
    fuel = np.array([[plan.certificate.fuel for plan in plans] for plans in (whole, parts)])
    assert fuel[1] == pytest.approx(fuel[0], rel=2e-2)
    assert fuel[1].sum() == pytest.approx(fuel[0].sum(), rel=5e-3)
