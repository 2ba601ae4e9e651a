"""The tables that experiments leave: their columns, and the names that stand in them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_type_hints

PREDICTED = "predicted"
"""Reading of a network's raw output, as in the paper: neither dynamics nor ends need hold."""

FLOWN = "flown"
"""Reading after projection onto the trajectories that obey the dynamics and both ends."""

PLAN = "plan"
"""Reading of a planner whose output is a flyable plan as it stands."""


@dataclass(frozen=True)
class Trial:
    """One planner's plan for one scenario (experiments 1 and 2)."""

    planner: str
    recipe: str  # of the training, or nothing
    training_seed: int  # or 0
    reading: str  # PLAN, FLOWN or PREDICTED
    n: int  # spacecraft
    trial: int  # number of the scenario
    node_collisions: int  # Eq. 5
    pair_conflicts: float  # pairs within r_col at any time; NaN where nothing is flown
    safe: bool  # whether separation is proven at all times
    min_separation: float  # of any pair at any time, m
    fuel: float  # Eq. 4, m/s²; of raw states, that of the controls nearest to them
    fuel_lower_bound: float  # m/s²
    boundary_error: float  # largest miss of an initial or goal position, m
    dynamics_error: float  # largest violation of Eq. 2 in position, m
    seconds: float  # to plan this scenario alone on one thread, where it was timed
    convex_solves: int  # joint convex programs


EXPERT, PLAIN = "expert", "plain"
OPTIMIZERS = (EXPERT, PLAIN)
"""Optimizers of experiment 3: our expert, or a plain SCP over all pairs, the paper's kind."""

CONVERGED, FIRST_SAFE = "converged", "first safe"
"""Stopping rules; the plain SCP knows the first alone."""

NO_SEED = "none"
"""Name, among seeds, of the optimizer's own start."""


@dataclass(frozen=True)
class WarmStart:
    """One run of an optimizer from one seed (experiment 3)."""

    optimizer: str  # of OPTIMIZERS
    n: int  # spacecraft
    trial: int  # number of the scenario
    seed: str  # NO_SEED: decoupled optima for the expert, nothing for the plain SCP
    training_seed: int  # of the network that the seed is from, or 0
    rule: str  # CONVERGED or FIRST_SAFE
    convex_solves: int  # joint convex programs
    seconds: float  # to make the seed and to plan, on one thread
    optimality_gap: float  # of the plan
    fuel: float  # of the plan, m/s²
    safe: bool  # whether the plan is proven safe at all times
    status: str  # of the plan; the plain SCP's is solved where it is clear at the nodes


VARIED = NODES, TIME_STEP = "nodes", "time_step"
"""What experiment 4 varies: T at the Δt of the training, or Δt at its T."""

LINEAR, TYPICAL = "linear", "e = 0.001"
ECCENTRICITIES = {TYPICAL: 0.001, "e = 0.01": 0.01}
"""Of the reference orbits of the nonlinear worlds: a usual low orbit's, and ten times that."""

WORLDS = (LINEAR, *ECCENTRICITIES)
"""In which plans are flown."""

ERRORS = NO_ERRORS, WITH_ERRORS = "none", "cold gas"
"""With which they are flown."""

LOOPS = OPEN, REPLANNED, MARGIN = "open loop", "replanned", "with margin"
"""As planned; planned anew at every node; anew, with more separation asked for than r_col."""


@dataclass(frozen=True)
class Flight:
    """One flight of one planner's plan (experiment 5)."""

    planner: str
    recipe: str  # of the training, or nothing
    training_seed: int  # or 0
    n: int  # spacecraft
    trial: int  # number of the scenario
    flight: int  # draw of errors, the same for all planners, worlds and loops
    world: str  # of WORLDS
    errors: str  # of ERRORS
    loop: str  # of LOOPS
    min_separation: float  # of any pair at any time, m
    within_radius: bool  # whether a pair came within the collision radius
    within_size: bool  # whether a pair came within the physical size
    goal_error: float  # largest distance of a craft from its goal at the end, m
    goal_velocity_error: float  # likewise of velocities, m/s
    delta_v: float  # of all craft, m/s
    delta_v_bound: float  # the least of any plan without errors, m/s
    missed_burns: int
    unsafe_replans: float  # nodes without a safe plan from there; NaN in open loop
    margin: float  # asked for beyond the collision radius, m


@dataclass(frozen=True)
class Training:
    """A trained model; None is what its run does not say."""

    arch: str
    recipe: str
    training_seed: int  # of weights, order and dropout
    version: int  # of the registered model
    parameters: int | None  # weights
    epochs: int | None  # that the training took
    train_instances: int | None
    best_epoch: int | None  # whose weights were kept
    valid_loss: float | None  # at the best epoch
    valid_flown_safe_share: float | None  # of validation scenarios, flown
    valid_flown_fuel: float | None  # average there, m/s²
    valid_flown_trials: float | None  # validation scenarios that were flown
    seconds: float | None
    device: str | None
    threads: str | None
    weights_kib: float | None  # size of the weights, KiB


@dataclass(frozen=True)
class Epoch:
    """One epoch of a training."""

    arch: str
    recipe: str
    training_seed: int
    epoch: int
    train_loss: float
    valid_loss: float


_TRIAL = get_type_hints(Trial)

TABLES: Mapping[str, Mapping[str, Any]] = {
    "trials": _TRIAL,
    "warmstarts": get_type_hints(WarmStart),
    "training": get_type_hints(Training),
    "curves": get_type_hints(Epoch),
    "transfer_times": {"varied": str, NODES: int, TIME_STEP: float, **_TRIAL},
    "flights": get_type_hints(Flight),
    # The scenarios' family, rounds taken, and rounds of the network's own answer.
    "ablations": {"family": str, "rounds": int, "own_rounds": int, **_TRIAL},
}
"""Columns of each table and the type of their values."""
