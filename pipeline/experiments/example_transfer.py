"""Example transfers by several planners: planned, written to a file and read."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.errors import InputError
from pipeline.experiments.trials import EvaluatedPlanner
from pipeline.figures.transfer import Example
from pipeline.orbit.transfer import track
from pipeline.scenario import Scenario

TRACK_STEPS = 12  # points of a track in each interval
PREFIX = "track:"  # beginning of the names of tracks in a file
MOST_BYTES = 250 * 10**6  # largest unpacked file that is read; a usual one has some hundred kB


def example_transfer(scenario: Scenario, planners: Sequence[EvaluatedPlanner]) -> Example:
    """One transfer by every planner; of trainings with the same label, by the first."""
    tracks = {}
    for evaluated in planners:
        if evaluated.label not in tracks:
            plan, problem = evaluated.planner.plan([scenario])[0], scenario.problem
            tracks[evaluated.label] = track(plan.states, plan.controls, problem, TRACK_STEPS)
    radius = scenario.problem.collision_radius
    return Example(scenario.name, scenario.initial, scenario.goal, tracks, radius)


def write_example(example: Example, path: Path) -> None:
    """Write an example to an npz file."""
    stored: dict[str, Any] = {"initial": example.initial, "goal": example.goal}
    stored |= {"name": example.title, "collision_radius": example.collision_radius}
    stored |= {f"{PREFIX}{label}": each for label, each in example.tracks.items()}
    np.savez_compressed(path, **stored)


def read_example(path: Path) -> Example:
    """The example in a file, without unpickling; InputError where it is damaged or holds none."""
    try:
        with ZipFile(path) as file:
            if sum(member.file_size for member in file.infolist()) > MOST_BYTES:
                raise ValueError(f"it takes more than {MOST_BYTES / 1e6:g} MB in memory")
        with np.load(path, allow_pickle=False) as file:
            stored = dict(file)
        initial, goal = _numbers(stored["initial"], 2, 6), _numbers(stored["goal"], 2, 6)
        tracks = {
            name.removeprefix(PREFIX): _numbers(stored[name], 3, 3)
            for name in stored
            if name.startswith(PREFIX)
        }
        if {len(goal), *map(len, tracks.values())} != {len(initial)}:
            raise ValueError("it has different numbers of spacecraft")
        title, radius = str(stored["name"]), float(_numbers(stored["collision_radius"], 0))
    except Exception as error:  # numpy and zipfile raise errors of many kinds where bytes are wrong
        raise InputError(f"it holds no example transfer ({error})") from error
    return Example(title, initial, goal, tracks, radius)


def _numbers(array: Any, dimensions: int, components: int | None = None) -> Float[Array, "..."]:
    """The array as floats; ValueError unless finite, with these dimensions and components."""
    shape = array.shape
    if array.dtype.kind not in "fi" or not np.isfinite(array).all():
        raise ValueError("it has values that are not finite numbers")
    if len(shape) != dimensions or (components is not None and shape[-1] != components):
        raise ValueError(f"it has an array of shape {shape}")
    return np.asarray(array, np.float64)
