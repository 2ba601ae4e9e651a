"""One transfer as several planners fly it, to be drawn."""

from collections.abc import Sequence

from pipeline.evaluation.trials import Entrant
from pipeline.orbit.transfer import track
from pipeline.report.results import Example
from pipeline.scenario import Scenario

TRACK_STEPS = 12
"""Points an interval in the example transfers."""


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
