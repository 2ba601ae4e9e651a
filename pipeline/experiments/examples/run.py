"""One transfer as several planners fly it, to be drawn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.experiments.trials import Entrant
from pipeline.orbit.transfer import track
from pipeline.scenario import Scenario

TRACK_STEPS = 12
"""Points an interval in the example transfers."""


@dataclass(frozen=True, eq=False)
class Example:
    """One transfer as several planners fly it.

    Attributes:
        title: what the transfer is.
        initial: initial states (n, 6), m and m/s.
        goal: goal states (n, 6).
        tracks: positions (n, K, 3) in m, dense in time, by the name of the planner.
        collision_radius: r_col, m.
    """

    title: str
    initial: Float[Array, "n 6"]
    goal: Float[Array, "n 6"]
    tracks: Mapping[str, Float[Array, "n _ 3"]]
    collision_radius: float


def example_transfer(scenario: Scenario, entrants: Sequence[Entrant]) -> Example:
    """Positions dense in time by label; of trainings that share one, the first is flown."""
    tracks = {}
    for entrant in entrants:
        label = label_of(entrant)
        if label not in tracks:
            plan = entrant.planner.plan([scenario])[0]
            tracks[label] = track(plan.states, plan.controls, scenario.problem, TRACK_STEPS)
    radius = scenario.problem.collision_radius
    return Example(scenario.name, scenario.initial, scenario.goal, tracks, radius)


def label_of(entrant: Entrant) -> str:
    """Name and recipe."""
    return f"{entrant.planner.name} {entrant.recipe}".strip()
