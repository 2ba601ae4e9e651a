"""What the flights of experiment 5 are called, and a row for each."""

from dataclasses import dataclass

LINEAR, TYPICAL = "linear", "e = 0.001"
ECCENTRICITIES = {TYPICAL: 0.001, "e = 0.01": 0.01}
"""Of the reference orbits of the nonlinear worlds: a usual low orbit's, and ten times that."""

WORLDS = (LINEAR, *ECCENTRICITIES)
"""In which plans are flown."""

ERRORS = NO_ERRORS, WITH_ERRORS = "none", "cold gas"
"""With which they are flown."""

LOOPS = OPEN, REPLANNED, MARGIN = "open loop", "replanned", "with margin"
"""How: as they are; made anew at every node; anew, with more separation asked for than r_col."""

SIZE = 0.35
"""Distance in m of two craft's centres at which two cubes of 20 cm can touch."""


@dataclass(frozen=True)
class Flight:
    """What became of one flight of one planner's plan.

    Attributes:
        planner: its name.
        recipe: of its training, or nothing.
        training_seed: of its training, or 0.
        n: swarm size.
        trial: number of the scenario.
        flight: number of the draw of errors; the same errors for all planners, worlds and loops.
        world: of WORLDS.
        errors: of ERRORS.
        loop: of LOOPS.
        min_separation: least distance of any pair at any time, m.
        within_radius: whether a pair came within the collision radius.
        within_size: whether a pair came within SIZE.
        goal_error: furthest that a craft ended from its goal, m.
        goal_velocity_error: likewise of velocities, m/s.
        delta_v: of all craft, m/s.
        delta_v_bound: what no plan without errors needs less than, m/s.
        missed_burns: how many were not made.
        unsafe_replans: nodes at which no plan was found that is safe from there; not a number
            where none was asked for.
        margin: asked for beyond the collision radius, m.
    """

    planner: str
    recipe: str
    training_seed: int
    n: int
    trial: int
    flight: int
    world: str
    errors: str
    loop: str
    min_separation: float
    within_radius: bool
    within_size: bool
    goal_error: float
    goal_velocity_error: float
    delta_v: float
    delta_v_bound: float
    missed_burns: int
    unsafe_replans: float
    margin: float
