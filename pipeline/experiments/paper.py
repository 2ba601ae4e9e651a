"""The numbers that the paper reports, each with its place in the paper.

Sabol, Yun, Adil, Choi, Madani, "Machine Learning Based Relative Orbit Transfer for Swarm
Spacecraft Motion Planning", IEEE Aerospace Conference 2022. The paper's "true" is the expert.
"""

from typing import NamedTuple

NETWORK_SIZE = 10
"""Spacecraft in the instances that the networks are trained on (Section IV, experiment 1)."""

LARGEST_SIZE = 30
"""Largest swarm of experiment 2 (Section IV)."""

NEURONS: dict[str, tuple[int, ...]] = {
    "ff1": (180,),
    "ff2": (180, 150),
    "ffcol": (180,),
    "lstm1": (180,),
    "lstm2": (180, 150),
    "lstmcol": (180,),
}
"""Neurons of each hidden layer (Table 1)."""


class Objectives(NamedTuple):
    """A row of the paper's Table 2, over its trials."""

    collisions_mean: float  # Eq. 5
    collisions_max: int
    fuel_mean: float  # Eq. 4, m/s²


OBJECTIVES: dict[str, Objectives] = {
    "expert": Objectives(0.113, 2, 0.0494),
    "ff1": Objectives(1.326, 13, 1.906),
    "ff2": Objectives(1.397, 11, 2.307),
    "ffcol": Objectives(1.440, 8, 2.98),
    "lstm1": Objectives(1.594, 13, 0.95),
    "lstm2": Objectives(1.428, 11, 0.76),
    "lstmcol": Objectives(1.520, 14, 0.99),
}
"""Collisions and fuel at n=10 (Table 2; Figures 2 and 3 show the same averages)."""

TRAIN_SECONDS: dict[str, float] = {
    "ff1": 25.133,
    "ff2": 30.079,
    "ffcol": 264.429,
    "lstm1": 206.810,
    "lstm2": 1291.4,
    "lstmcol": 986.14,
}
"""Training time, s (Table 3)."""

COLLISIONS_AT_30: dict[str, float] = {"expert": 1.06, "ff1": 4.64, "lstm1": 14.74}
"""Average collisions at n=30: the expert, the best and the worst network (experiment 2)."""

FUEL_AT_30: dict[str, float] = {"expert": 0.1484, "lstm2": 2.24, "ffcol": 5.71}
"""Average fuel at n=30: the expert, the best and the worst network, m/s² (experiment 2)."""

EXPERT_SECONDS_AT_30 = 10.0
"""Run time of the convex optimizer at n=30, "nearly 10 seconds" (experiment 2)."""

NETWORK_SECONDS = "a few hundredths of a second"
"""Longest run time of a network for n=2..30, in the paper's words (experiment 2)."""

NO_SEED_SECONDS = 20.0
"""Convergence at n=10 without a seed, "roughly twenty seconds" (experiment 3)."""

NETWORK_SEED_SECONDS = 5.0
"""Convergence at n=10 from a network's seed takes "less than" this (experiment 3)."""

COLLISIONS = {
    NETWORK_SIZE: {planner: row.collisions_mean for planner, row in OBJECTIVES.items()},
    LARGEST_SIZE: COLLISIONS_AT_30,
}
"""Average collisions by swarm size and planner."""

FUEL = {
    NETWORK_SIZE: {planner: row.fuel_mean for planner, row in OBJECTIVES.items()},
    LARGEST_SIZE: FUEL_AT_30,
}
"""Average fuel by swarm size and planner, m/s²."""
