"""What experiment 3 tells apart, and what a run of it is told as."""

from dataclasses import dataclass

EXPERT, PLAIN = "expert", "plain"
OPTIMIZERS = (EXPERT, PLAIN)
"""What seeds are given to: our expert, or a plain SCP over all pairs, the paper's kind."""

CONVERGED, FIRST_SAFE = "converged", "first safe"
"""Stopping rules; the plain SCP knows the first alone."""


NO_SEED = "none"
"""What the optimizer's own start is called among seeds."""


@dataclass(frozen=True)
class WarmStart:
    """One run of an optimizer from one seed.

    Attributes:
        optimizer: of OPTIMIZERS.
        n: swarm size.
        trial: number of the scenario.
        seed: where the seed comes from; "none" is the optimizer's own start: each craft's own
            LP with the expert, a blank one with the plain SCP.
        training_seed: of the network that it comes from, or 0.
        rule: stopping rule, of RULES.
        convex_solves: joint convex programs.
        seconds: time to make the seed and to plan, on one thread.
        optimality_gap: of the plan.
        fuel: of the plan, m/s².
        safe: whether the plan is proven safe at all times.
        status: of the plan; the plain SCP's is solved where it is clear at the nodes.
    """

    optimizer: str
    n: int
    trial: int
    seed: str
    training_seed: int
    rule: str
    convex_solves: int
    seconds: float
    optimality_gap: float
    fuel: float
    safe: bool
    status: str
