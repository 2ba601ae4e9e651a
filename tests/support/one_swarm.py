"""One swarm by itself, where the project judges several side by side."""

from pipeline.orbit.arrays import Controls, States
from pipeline.orbit.partition import swarm_partition
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import Separation, least_separations


def least_separation(states: States, controls: Controls, problem: Problem) -> Separation:
    """The least distance of any pair of one swarm at any time of a flown trajectory."""
    return least_separations(states, controls, problem, swarm_partition((len(states),)))[0]
