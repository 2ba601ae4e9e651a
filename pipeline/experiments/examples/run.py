"""One transfer as several planners fly it, to be drawn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.experiments.trials import Entrant
from pipeline.orbit.transfer import track
from pipeline.scenario import Scenario

TRACK_STEPS = 12
"""Points an interval in the example transfers."""

TRACK = "track:"
"""What names of tracks begin with in a file."""


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
        if entrant.label not in tracks:
            plan = entrant.planner.plan([scenario])[0]
            tracks[entrant.label] = track(plan.states, plan.controls, scenario.problem, TRACK_STEPS)
    radius = scenario.problem.collision_radius
    return Example(scenario.name, scenario.initial, scenario.goal, tracks, radius)


def write_example(example: Example, path: Path) -> None:
    """Keep an example in a file of numpy's."""
    tracks: dict[str, Any] = {f"{TRACK}{label}": each for label, each in example.tracks.items()}
    np.savez_compressed(
        path,
        initial=example.initial,
        goal=example.goal,
        name=np.array(example.title),
        collision_radius=np.array(example.collision_radius),
        **tracks,
    )


def read_example(path: Path) -> Example:
    """The example that a file has."""
    with np.load(path, allow_pickle=False) as stored:
        tracks = {k.removeprefix(TRACK): stored[k] for k in stored.files if k.startswith(TRACK)}
        return Example(
            title=str(stored["name"]),
            initial=stored["initial"],
            goal=stored["goal"],
            tracks=tracks,
            collision_radius=float(stored["collision_radius"]),
        )
