"""The files of one craft against torch: a swarm whose craft run them, and tell each other."""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.errors import ProlearnError
from pipeline.networks.model import Model
from pipeline.networks.onnx_files import open_session
from pipeline.networks.refiner.bargain import Bargain
from pipeline.networks.refiner.on_board.steps import STEPS, takes
from pipeline.networks.refiner.on_board.swarm import Known, fly_rounds
from pipeline.networks.refiner.rounds import begin, play, start
from pipeline.networks.swarms import swarms
from pipeline.orbit.problem import Problem
from pipeline.scenario import draw

TOLERANCE = 1e-5
"""Largest difference of a control from torch, as a share of the largest control."""

MOST_TIES = 1 / 3
"""Share of the swarms that may meet another optimum of the same fuel."""

SIZES = (2, 10, 30)
"""Swarm sizes that are flown."""

DRAWS = 2
"""Swarms of each."""


@dataclass(frozen=True)
class Compared:
    """The controls of one swarm.

    Attributes:
        difference: the largest, as a share of the largest control.
        tie: whether another optimum of the same fuel was met, before which this holds.
    """

    difference: float
    tie: bool


@dataclass(frozen=True)
class Checked:
    """What was measured.

    Attributes:
        swarms: swarms that were flown.
        ties: those in which another optimum of the same fuel was met.
        encounters: most encounters of a craft in them.
        difference: largest difference from torch, as a share of a swarm's largest control.
        seconds: median time of a step on one core, by its name.
    """

    swarms: int
    ties: int
    encounters: int
    difference: float
    seconds: Mapping[str, float]


class Files:
    """Runs steps by their files, and keeps the times."""

    def __init__(self, files: Mapping[str, Path]) -> None:
        self.session = {name: open_session(path) for name, path in files.items()}
        self.seconds: dict[str, list[float]] = {name: [] for name in files}
        self.encounters = 0

    def __call__(self, name: str, known: Known) -> Mapping[str, Any]:
        """The outputs of a step by name."""
        given = {one: known[one] for one in takes(STEPS[name])}
        started = time.perf_counter()
        found = self.session[name].run(None, given)
        self.seconds[name].append(time.perf_counter() - started)
        self.encounters = max(self.encounters, len(known.get("interval", ())))
        return dict(zip(STEPS[name].gives, found, strict=True))


def check(files: Mapping[str, Path], model: Model) -> Checked:
    """Fly random swarms by the files, all rounds, and compare all controls with torch's.

    Raises:
        InputError: where onnxruntime is not installed.
        ProlearnError: where a control differs by more than TOLERANCE for no good reason, or little
            could be compared.
    """
    run, compared = Files(files), []
    for initial, goal in _drawn(model):
        given = _by_files(run, model, initial, goal)
        compared.append(compare(given, together(_bargain(model), model.problem, initial, goal)))
    difference = max(one.difference for one in compared)
    if difference > TOLERANCE:
        raise ProlearnError(
            f"onnxruntime's controls differ from torch's by {difference:.2g} of the largest; "
            f"expected at most {TOLERANCE:g}: no file was written."
        )
    seconds = {name: float(np.median(times or [0.0])) for name, times in run.seconds.items()}
    ties = sum(one.tie for one in compared)
    if ties > MOST_TIES * len(compared):
        raise ProlearnError(
            f"{ties} of {len(compared)} swarms met another optimum of the same fuel, so little "
            f"was compared; expected at most {MOST_TIES:.0%}: no file was written."
        )
    return Checked(len(compared), ties, run.encounters, difference, seconds)


def compare(given: Float[Array, "_ n m"], wanted: Float[Array, "_ n m"]) -> Compared:
    """Controls before and after each round against those that are wanted.

    A craft's program may have several optima that cost the same; then rounding decides between
    them, and the rounds after may go another way. So rounds are compared up to the first that
    differs, and that one by the fuel of each craft.
    """
    share = np.abs(given - wanted).max(axis=(1, 2)) / np.abs(wanted).max()
    if share.max() <= TOLERANCE:
        return Compared(float(share.max()), tie=False)
    first = int((share > TOLERANCE).argmax())
    fuel, same = (np.abs(controls[first]).sum(axis=1) for controls in (given, wanted))
    if np.abs(fuel - same).max() > TOLERANCE * same.max():
        return Compared(float(share[first]), tie=False)
    return Compared(float(share[:first].max(initial=0.0)), tie=True)


def _drawn(model: Model) -> Iterator[tuple[Float[Array, "n 6"], Float[Array, "n 6"]]]:
    """Swarms between random rings: where they start and end."""
    for n in SIZES:
        for k in range(DRAWS):
            scenario = draw("rings", 0, n, k, model.problem, "valid")
            yield scenario.initial, scenario.goal


def _by_files(
    run: Files, model: Model, initial: Float[Array, "n 6"], goal: Float[Array, "n 6"]
) -> Float[Array, "_ n m"]:
    """Controls before and after each round, m/s²."""
    network, radius = _bargain(model), model.problem.collision_radius
    found = fly_rounds(run, initial, goal, radius, rounds=network.rounds)
    return np.stack(list(found))


@torch.no_grad()
def together(
    network: Bargain, problem: Problem, initial: Float[Array, "n 6"], goal: Float[Array, "n 6"]
) -> Float[Array, "_ n m"]:
    """The same of the whole swarm at once, by torch."""
    task = begin(swarms(problem, initial[None], goal[None]))
    state = start(task)
    controls = [state.controls]
    for number in range(network.rounds):
        state = play(network, task, state, number)
        controls.append(state.controls)
    return torch.stack(controls).numpy() * problem.collision_radius / problem.time_step**2


def _bargain(model: Model) -> Bargain:
    return cast("Bargain", model.network)
