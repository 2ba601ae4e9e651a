"""The tables that experiments produce: their columns, and the names used as values."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_type_hints

from pipeline.flight import FEEDBACK, MARGIN, OPEN, REPLANNED

# How a plan is read: a network's raw output, as in the paper, which need not obey the dynamics or
# meet the ends; its projection onto the trajectories that do; or a planner's plan, which does
PREDICTED, FLOWN, PLAN = "predicted", "flown", "plan"


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
    dynamics_error: float  # largest violation of Eq. 2, m; if predicted, velocities over e as well
    seconds: float  # to plan this scenario alone on one thread, where it was timed
    convex_solves: int  # joint convex programs


# Optimizers of experiment 3: our expert, or a plain SCP over all pairs, the paper's kind
OPTIMIZERS = EXPERT, PLAIN = "expert", "plain"
CONVERGED, FIRST_SAFE = "converged", "first safe"  # stopping rules; the plain SCP has the first
NO_SEED = "none"  # name, among seeds, of the optimizer's own start


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


VARIED = NODES, TIME_STEP = "nodes", "time_step"  # in experiment 4: T or Δt of the training

LINEAR, TYPICAL = "linear", "e = 0.001"
# Of the reference orbits of the nonlinear worlds: a usual low orbit's, and ten times that
ECCENTRICITIES = {TYPICAL: 0.001, "e = 0.01": 0.01}
WORLDS = (LINEAR, *ECCENTRICITIES)  # in which plans are flown with errors and replanned
# Of those about which plans are also made as flown, orbits far from circular among them
ORBITS = {**ECCENTRICITIES, "e = 0.1": 0.1, "e = 0.5": 0.5}
PLANNED = LINEAR, AS_FLOWN = LINEAR, "as flown"  # the models that plans are made for
ERRORS = NO_ERRORS, WITH_ERRORS = "none", "cold gas"  # of thrust and navigation in a flight
# As planned; planned for a RISK and corrected at every node; planned anew at every node; anew, with
# more separation asked for than r_col
LOOPS = OPEN, FEEDBACK, REPLANNED, MARGIN
RISK = 1e-3  # collision risk to which plans flown with feedback are limited


@dataclass(frozen=True)
class Flight:
    """One flight of one planner's plan (experiment 5)."""

    planner: str
    recipe: str  # of the training, or nothing
    training_seed: int  # or 0
    n: int  # spacecraft
    trial: int  # number of the scenario
    flight: int  # draw of errors, the same for all planners, worlds and loops
    planned: str  # of PLANNED
    world: str  # LINEAR, or of ORBITS
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
    # Nodes without a safe plan from there; 1 if a plan as flown or of RISK is not solved; else NaN
    unsafe_replans: float


@dataclass(frozen=True)
class Training:
    """A trained model; a field is None where the run of its training does not say it."""

    arch: str  # with the version (ff1/3) where others beside it differ in more than the seed
    recipe: str
    training_seed: int  # of weights, order and dropout
    n: int | None  # spacecraft of its training
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
class EpochLosses:
    """Training and validation loss of one epoch: a point of the learning curve."""

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
    "curves": get_type_hints(EpochLosses),
    "transfer_times": {"varied": str, NODES: int, TIME_STEP: float, **_TRIAL},
    "flights": get_type_hints(Flight),
}
"""Columns of each table and the type of their values."""
