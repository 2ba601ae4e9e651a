"""What proves of scenarios that they have no plan, before any is searched for."""

import numpy as np

from pipeline.expert.batch import Batch
from pipeline.expert.own import OwnOptima
from pipeline.orbit.separation import swarm_node_collisions
from pipeline.scenario import Scenario


def refuted(batch: Batch, own: OwnOptima) -> list[str]:
    """Why each scenario has no plan, in words; nothing where that is not known.

    A craft on its own cannot make its transfer, or a pair is within the collision radius at one of
    its ends, where no control can move it.
    """
    ends = np.stack([batch.initial, batch.goal], axis=1)
    close = swarm_node_collisions(ends, batch.problem.collision_radius, batch.swarms)
    parts = zip(batch.scenarios, batch.split(own.impossible), close.tolist(), strict=True)
    limited = batch.problem.max_acceleration is not None
    given = "within max_acceleration" if limited else "with any thrust, however large"
    return [
        f"craft {int(impossible.argmax())} cannot reach its goal {given}, which is proven"
        if impossible.any()
        else _too_close(scenario)
        if collisions
        else ""
        for scenario, impossible, collisions in parts
    ]


def _too_close(scenario: Scenario) -> str:
    """Which pair is too close at an end."""
    radius, near = scenario.problem.collision_radius, []
    i, j = np.triu_indices(scenario.n, 1)
    for end, states in (("start", scenario.initial), ("goal", scenario.goal)):
        apart = np.linalg.norm(states[i, :3] - states[j, :3], axis=1)
        near.append((float(apart.min()), int(apart.argmin()), end))
    distance, pair, end = min(near)
    return (
        f"craft {i[pair]} and {j[pair]} are {distance:.6g} m apart at the {end}, whatever is "
        f"planned; collision_radius is {radius:g} m"
    )
