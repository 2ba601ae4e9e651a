"""One transfer as several planners fly it, to be drawn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.experiments.trials import Entrant
from pipeline.orbit.transfer import track
from pipeline.scenario import Scenario

TRACK_STEPS = 12
"""Points an interval in the example transfers."""

TRACK = "track:"
"""What names of tracks begin with in a file."""

MOST_BYTES = 250 * 10**6
"""Size in memory of the largest file that is read; a usual one takes some hundred kB."""


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
    """The example that a file has; nothing in it is unpickled.

    Raises:
        InputError: where the file is damaged, or holds something else.
    """
    try:
        stored = _arrays(path)
        initial, goal = _numbers(stored["initial"], 2, 6), _numbers(stored["goal"], 2, 6)
        tracks = {
            name.removeprefix(TRACK): _numbers(stored[name], 3, 3)
            for name in stored
            if name.startswith(TRACK)
        }
        if {len(goal), *map(len, tracks.values())} != {len(initial)}:
            raise ValueError("it has different numbers of spacecraft")
        title, radius = str(stored["name"]), float(_numbers(stored["collision_radius"], 0))
    except Exception as error:  # numpy and zipfile raise errors of many kinds where bytes are wrong
        raise InputError(f"it holds no example transfer ({error})") from error
    return Example(title, initial, goal, tracks, radius)


def _arrays(path: Path) -> dict[str, Any]:
    """The arrays in a file of numpy's, by name."""
    with ZipFile(path) as file:
        if sum(member.file_size for member in file.infolist()) > MOST_BYTES:
            raise ValueError(f"it takes more than {MOST_BYTES / 1e6:g} MB in memory")
    with np.load(path, allow_pickle=False) as stored:
        return dict(stored)


def _numbers(array: Any, dimensions: int, components: int | None = None) -> Float[Array, "..."]:
    """Finite numbers with so many dimensions, the last of them of so many components."""
    shape = array.shape
    if array.dtype.kind not in "fi" or not np.isfinite(array).all():
        raise ValueError("it has values that are not finite numbers")
    if len(shape) != dimensions or (components is not None and shape[-1] != components):
        raise ValueError(f"it has an array of shape {shape}")
    return np.asarray(array, np.float64)
