"""The numbers that the paper reports, each with its place in the paper.

Sabol, Yun, Adil, Choi, Madani, "Machine Learning Based Relative Orbit Transfer for Swarm
Spacecraft Motion Planning", IEEE Aerospace Conference 2022. The paper's "true" is the expert.
"""

from typing import Any

import pandas as pd

NETWORK_SIZE = 10  # spacecraft in the instances that networks are trained on (Section IV)
LARGEST_SIZE = 30  # largest swarm of experiment 2 (Section IV)

TRAININGS = pd.DataFrame(
    [
        ("ff1", "180", 25.133),
        ("ff2", "180, 150", 30.079),
        ("ffcol", "180", 264.429),
        ("lstm1", "180", 206.810),
        ("lstm2", "180, 150", 1291.4),
        ("lstmcol", "180", 986.14),
    ],
    columns=["arch", "paper_neurons", "paper_seconds"],
).set_index("arch")
"""Neurons of each hidden layer (Table 1), training time in s (Table 3)."""

OBJECTIVES = pd.DataFrame(
    [
        ("expert", 0.113, 2, 0.0494),
        ("ff1", 1.326, 13, 1.906),
        ("ff2", 1.397, 11, 2.307),
        ("ffcol", 1.440, 8, 2.98),
        ("lstm1", 1.594, 13, 0.95),
        ("lstm2", 1.428, 11, 0.76),
        ("lstmcol", 1.520, 14, 0.99),
    ],
    columns=["planner", "collisions_mean", "collisions_max", "fuel_mean"],
).set_index("planner")
"""Collisions (Eq. 5) and fuel (Eq. 4, m/s²) at n=10 (Table 2; Figures 2 and 3)."""

COLLISIONS: dict[int, dict[Any, float]] = {
    NETWORK_SIZE: OBJECTIVES["collisions_mean"].to_dict(),
    LARGEST_SIZE: {"expert": 1.06, "ff1": 4.64, "lstm1": 14.74},
}
"""Average collisions by swarm size; at n=30 the best and the worst network (experiment 2)."""

FUEL: dict[int, dict[Any, float]] = {
    NETWORK_SIZE: OBJECTIVES["fuel_mean"].to_dict(),
    LARGEST_SIZE: {"expert": 0.1484, "lstm2": 2.24, "ffcol": 5.71},
}
"""Average fuel by swarm size, m/s²; at n=30 the best and the worst network (experiment 2)."""

# Experiment 2: of the convex optimizer at n=30, "nearly" this, s; of networks for n=2..30, at most
EXPERT_SECONDS_AT_30, NETWORK_SECONDS = 10.0, "a few hundredths of a second"

# Experiment 3: convergence at n=10, "roughly" this without a seed, "less than" this from a network
NO_SEED_SECONDS, NETWORK_SEED_SECONDS = 20.0, 5.0
