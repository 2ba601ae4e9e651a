"""Cuts where a craft that has lost its thrust would meet another, and what no plan can help."""

import numpy as np
from jaxtyping import Bool, Float

from pipeline.arrays import Array
from pipeline.expert.cuts import Apart, Cuts
from pipeline.expert.spread import Spread, conflicts_less
from pipeline.orbit.approaches import Swarms
from pipeline.orbit.infeasibility import unavoidable
from pipeline.orbit.passive_safety import LossEncounters, loss_encounters
from pipeline.orbit.problem import Problem
from pipeline.plan import Requirements
from pipeline.scenario import Scenario


def conflicts_asked_about(
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
    within: float,
    moved: Bool[Array, "n"],
    requirements: Requirements,
    *,
    margin: float,
    spread: Spread | None = None,
    swarms: Swarms | None = None,
    beside: float = 0.0,
) -> tuple[Cuts, Float[Array, "k"]]:
    """``conflicts_less`` in flight and, where it is required, conflicts after a loss of thrust."""
    cuts, bound = conflicts_less(
        spread,
        states,
        controls,
        problem,
        within,
        moved,
        margin=margin,
        requirements=requirements,
        swarms=swarms,
        beside=beside,
    )
    orbits = requirements.passive_safety
    if orbits is None:
        return cuts, bound
    more, theirs = loss_conflicts(states, controls, problem, orbits, within, moved, swarms)
    return cuts + more, np.concatenate([bound, theirs])


def loss_conflicts(
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
    orbits: float,
    within: float,
    moved: Bool[Array, "n"],
    swarms: Swarms | None = None,
) -> tuple[Cuts, Float[Array, "k"]]:
    """Where a craft adrift and another come within a distance, and how close, as ``conflicts``.

    Args:
        states: node states, m and m/s, both ends met.
        controls: m/s².
        problem: the problem.
        orbits: how long a craft drifts.
        within: distance of interest, m.
        moved: craft whose controls are to have a say.
        swarms: which craft belong together; by default all of them.
    """
    found = loss_encounters(states, controls, problem, orbits, within, swarms=swarms, moved=moved)
    return loss_cuts(found, states, problem), found.bound


def loss_cuts(found: LossEncounters, states: Float[Array, "n T 6"], problem: Problem) -> Cuts:
    """Cuts at encounters. The craft of each are those whose controls have a say in it.

    A craft adrift has its say before it loses its thrust, so none from the first node on, and the
    other none once it is on its goal's orbit. Where one has none it is where it is, and the cut is
    about the other alone, so that it joins no two craft.

    Args:
        found: encounters, of which in each at least one craft has a say.
        states: node states, m and m/s.
        problem: the problem.
    """
    h, last = problem.time_step, problem.nodes - 1
    drifted, _ = problem.dynamics.step(h * (found.interval - found.node))
    adrift = found.free @ drifted
    beyond, _ = problem.dynamics.step(h * np.maximum(found.interval - last, 0))
    goal = np.matvec(found.free @ beyond, states[found.other, last])
    start = np.matvec(adrift, states[found.lost, found.node])
    fixed, arrived = found.node == 0, found.interval >= last
    return Cuts(
        first=np.where(fixed, found.other, found.lost),
        second=np.where(arrived, found.lost, found.other),
        interval=found.node,
        free=_unless(fixed, adrift),
        pushed=np.zeros_like(found.pushed),
        apart=Apart(
            interval=np.where(arrived, 0, found.interval),
            free=_unless(arrived, found.free),
            pushed=_unless(arrived, found.pushed),
            offset=_unless(~fixed, start) - _unless(~arrived, goal),
        ),
    )


def _unless(mask: Bool[Array, "k"], values: Float[Array, "k *rest"]) -> Float[Array, "k *rest"]:
    """The values, and zero where a mask says so."""
    return np.where(mask.reshape(-1, *[1] * (values.ndim - 1)), 0.0, values)


def what_no_plan_can_help(scenario: Scenario, orbits: float) -> str:
    """Why no plan is passively safe, in words, where the ends alone say so; else nothing."""
    found = unavoidable(scenario.initial, scenario.goal, scenario.problem, orbits)
    if found is None or found.pair is None:
        return ""
    (i, j), problem = found.pair, scenario.problem
    whence = "its start" if found.node == 0 else "its goal"
    return (
        f"craft {i}, adrift from {whence}, comes within {found.distance:.6g} m of craft {j}, which "
        f"drifts on from its goal, at {found.time:.6g} s, whatever is planned; collision_radius "
        f"is {problem.collision_radius:g} m"
    )
