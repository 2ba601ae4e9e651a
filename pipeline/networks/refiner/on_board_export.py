"""Export of a refiner as ONNX files, one for each step of one craft, and their check."""

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.export import Dim

from pipeline.arrays import Array, Float
from pipeline.errors import InputError, ProlearnError
from pipeline.files import published
from pipeline.networks.model import Model
from pipeline.networks.onnx_export import open_session, traced, write
from pipeline.networks.recipes import REFINER
from pipeline.networks.refiner import on_board
from pipeline.networks.refiner.model import problem_data, run_round, start
from pipeline.networks.refiner.refiner import MessagePassing
from pipeline.orbit.arrays import Formation
from pipeline.orbit.decoupled import facets_of
from pipeline.orbit.problem import Problem
from pipeline.scenario import draw
from pipeline.scratch import scratch_folder

SCHEMA = "prolearn.onnx.craft/2"
ANY = {"P": 5, "Q": 4}  # axes of any length, and the length with which graphs are traced
TOLERANCE = 1e-5  # largest difference from the whole swarm's controls, as a share of the largest
MOST_TIES = 1 / 3  # largest share of the swarms that may find another optimum of the same fuel
SIZES = (2, 10, 30)  # swarm sizes that are flown
DRAWS = 2  # swarms of each
FITTING = 15.0  # collision radius at which they are drawn, m; they grow with the network's

AgentMemory = dict[str, Any]  # what one craft knows: arrays by the names of ``on_board.VALUES``
# Runs a step, by its name, on what one craft knows, and returns its outputs by name
StepRunner = Callable[[str, AgentMemory], Mapping[str, Any]]
# One side of an encounter: a craft, its index among that craft's, the other craft, the index there
Edge = tuple[int, int, int, int]


def fly_rounds(
    run: StepRunner, initial: Formation, goal: Formation, r_col: float, *, rounds: int
) -> Iterator[Float[Array, "n m"]]:
    """Run the steps of all craft of a swarm: controls, m/s², at first and after each round."""
    swarm: list[AgentMemory] = [
        {"initial": start, "goal": end, "r_col": np.array(r_col)}
        for start, end in zip(initial, goal, strict=True)
    ]
    for craft in swarm:
        craft.update(run("begin", craft))
    edges = _find_encounters(run, swarm)
    _exchange(swarm, edges, ("nodes", "price"))
    yield np.stack([craft["controls"] for craft in swarm])
    for number in range(rounds):
        for name, step in on_board.ROUND.items():
            for k in {edge[0] for edge in edges}:  # others keep their decoupled optimum
                swarm[k].update(run(name, {**swarm[k], "number": np.array(number)}))
            live = [e for e in edges if step.tells_all or swarm[e[0]]["live"][e[1]]]
            _exchange(swarm, live, step.tells)
        yield np.stack([craft["controls"] for craft in swarm])


def _find_encounters(run: StepRunner, swarm: Sequence[AgentMemory]) -> list[Edge]:
    """The encounters that each craft finds by itself, as edges from both sides."""
    places: dict[tuple[int, int, int], int] = {}
    for k, craft in enumerate(swarm if len(swarm) > 1 else ()):
        others = [j for j in range(len(swarm)) if j != k]
        told = np.stack([swarm[j]["states"] for j in others])
        which, interval = np.nonzero(run("meet", {**craft, on_board.TOLD + "states": told})["met"])
        places |= {
            (k, others[q], int(t)): place
            for place, (q, t) in enumerate(zip(which, interval, strict=True))
        }
        states = craft["states"]
        craft["interval"] = interval
        craft["nodes"] = np.stack([states[interval], states[interval + 1]], axis=1)
        craft["price"], craft["first_price"] = np.zeros((2, len(interval)))
    return [(k, place, j, places[j, k, t]) for (k, j, t), place in places.items()]


def _exchange(swarm: Sequence[AgentMemory], edges: Sequence[Edge], names: Sequence[str]) -> None:
    """Send the values of these names along edges, from the other craft to each craft."""
    for name in names:
        for craft in swarm:  # zeros of the right shape until something is sent
            if name in craft:
                craft.setdefault(on_board.TOLD + name, np.zeros_like(craft[name]))
        for k, place, other, there in edges:
            swarm[k][on_board.TOLD + name][place] = swarm[other][name][there]


@dataclass(frozen=True)
class Discrepancy:
    """Difference of one swarm's controls from those expected."""

    difference: float  # the largest, as a share of the largest control
    tie: bool  # whether another optimum of equal fuel was found; rounds before it are compared


@dataclass(frozen=True)
class ExportedCraft:
    """The files of one craft, their accuracy and their speed."""

    folder: Path  # where they are, each named after its step
    kib: Mapping[str, float]  # size of each, by step, KiB
    sha256: Mapping[str, str]  # digest of each, by step
    told: Mapping[str, int]  # numbers sent in each round for each live encounter, by name
    swarms: int  # swarms that were flown
    ties: int  # those in which another optimum of the same fuel was found
    encounters: int  # largest number of encounters of a craft in them
    difference: float  # largest from the whole swarm's, as a share of its largest control
    seconds: Mapping[str, float]  # median time of a step on one core, by its name


class Files:
    """The files of steps in a folder, which run them and record the times."""

    def __init__(self, folder: Path) -> None:
        self.session = {name: open_session(file_of(folder, name)) for name in on_board.STEPS}
        self.seconds: dict[str, list[float]] = {name: [] for name in on_board.STEPS}
        self.encounters = 0

    def __call__(self, name: str, known: AgentMemory) -> Mapping[str, Any]:
        """The outputs of a step by name."""
        given = {key: known[key] for key in on_board.STEPS[name].takes}
        started = time.perf_counter()
        found = self.session[name].run(None, given)
        self.seconds[name].append(time.perf_counter() - started)
        self.encounters = max(self.encounters, len(known.get("interval", ())))
        return dict(zip(on_board.STEPS[name].gives, found, strict=True))


def check(folder: Path, model: Model) -> ExportedCraft:
    """Fly random swarms by the files, all rounds, and compare all controls with the model's.

    InputError where onnxruntime is not installed. ProlearnError where a control differs by more
    than TOLERANCE without a tie, or ties left too little to compare.
    """
    network, problem = model.network, model.problem
    assert isinstance(network, MessagePassing), "a refiner's"
    run, compared, radius = Files(folder), [], problem.collision_radius
    drawn_for, size = replace(problem, collision_radius=FITTING), radius / FITTING
    for n in SIZES:
        for k in range(DRAWS):
            scenario = draw("rings", 0, n, k, drawn_for, "valid")
            ends = scenario.initial * size, scenario.goal * size
            given = np.stack(list(fly_rounds(run, *ends, radius, rounds=network.rounds)))
            compared.append(compare(given, swarm_controls(network, problem, *ends)))
    difference = max(found.difference for found in compared)
    if difference > TOLERANCE:
        raise ProlearnError(
            f"onnxruntime's controls differ from the model's by {difference:.2g} of the largest; "
            f"expected at most {TOLERANCE:g}: no file was written."
        )
    ties = sum(found.tie for found in compared)
    if ties > MOST_TIES * len(compared):
        raise ProlearnError(
            f"{ties} of {len(compared)} swarms met another optimum of the same fuel, so little "
            f"was compared; expected at most {MOST_TIES:.0%}: no file was written."
        )
    content = {name: file_of(folder, name).read_bytes() for name in on_board.STEPS}
    return ExportedCraft(
        folder=folder,
        kib={name: len(graph) / 1024 for name, graph in content.items()},
        sha256={name: hashlib.sha256(graph).hexdigest() for name, graph in content.items()},
        told=on_board.told_each_round(network.message),
        swarms=len(compared),
        ties=ties,
        encounters=run.encounters,
        difference=difference,
        seconds={name: float(np.median(times or [0.0])) for name, times in run.seconds.items()},
    )


def compare(given: Float[Array, "_ n m"], wanted: Float[Array, "_ n m"]) -> Discrepancy:
    """Compare controls before and after each round with those expected.

    A craft's program may have several optima that cost the same; then rounding decides between
    them, and the rounds after may differ. So rounds are compared up to the first that differs, and
    that one by the fuel of each craft.
    """
    share = np.abs(given - wanted).max(axis=(1, 2)) / np.abs(wanted).max()
    if share.max() <= TOLERANCE:
        return Discrepancy(float(share.max()), tie=False)
    first = int((share > TOLERANCE).argmax())
    fuel, same = (np.abs(controls[first]).sum(axis=1) for controls in (given, wanted))
    if np.abs(fuel - same).max() > TOLERANCE * same.max():
        return Discrepancy(float(share[first]), tie=False)
    return Discrepancy(float(share[:first].max(initial=0.0)), tie=True)


def swarm_controls(
    network: MessagePassing, problem: Problem, initial: Formation, goal: Formation
) -> Float[Array, "_ n m"]:
    """Controls of the whole swarm at first and after each round, without the files, m/s²."""
    radius = np.array([problem.collision_radius])
    data = problem_data(problem, initial[None], goal[None], radius)
    now = start(data)
    controls = [now.controls]
    for number in range(network.rounds):
        now = run_round(network.arrays, data, now, number)
        controls.append(now.controls)
    return np.stack(controls) * radius / problem.time_step**2


def export_craft(
    model: Model, folder: Path, *, about: Mapping[str, Any] | None = None
) -> ExportedCraft:
    """Write the steps that one craft of a refiner runs, as ``begin.onnx`` and so on.

    Files of these names are replaced; each has the JSON values ``about`` in its metadata.
    InputError where onnx or onnxruntime is not installed, the folder is a file, or the time grid
    has two intervals or is too fine for a table of optimal bases. ProlearnError where a step cannot
    be exported, or a swarm whose craft run them gets other controls.
    """
    if folder.is_file():
        raise InputError(f"{folder} is a file; expected a folder for the files of a refiner.")
    network = model.network
    if model.problem.intervals == 2:
        raise InputError(
            "the refiner was trained on transfers of two intervals, which one pair of burns makes; "
            "expected three or more, so that there is something to refine."
        )
    if facets_of(model.problem) is None:
        raise InputError(
            f"the refiner was trained on {model.problem.intervals} intervals about an orbit where "
            "all motion is coupled; expected so few, about 40, that a file holds all optimal bases."
        )
    assert isinstance(network, MessagePassing), "a refiner's"
    with scratch_folder() as temporary:
        for name, step in on_board.STEPS.items():
            described = {"schema": SCHEMA, "step": name, "tells": step.tells, **(about or {})}
            made = step(network, model.problem)
            _write(made, network.message, file_of(temporary, name), described)
        exported = check(temporary, model)
        for name in on_board.STEPS:
            with published(file_of(folder, name)) as path:
                path.write_bytes(file_of(temporary, name).read_bytes())
    return replace(exported, folder=folder)


def file_of(folder: Path, step: str) -> Path:
    """The file of a step."""
    return folder / f"{step}.onnx"


def _write(step: on_board.Step, message: int, path: Path, about: Mapping[str, Any]) -> None:
    sizes = on_board.sizes_of(step.problem.nodes, message, ANY["P"], ANY["Q"])
    inputs, gives = step.takes, on_board.outputs(type(step))
    axes = {
        name: [letter if letter in ANY else None for letter in on_board.value(name).shape]
        for name in (*inputs, *gives)
    }
    dynamic = tuple({k: Dim.DYNAMIC for k, a in enumerate(axes[name]) if a} for name in inputs)
    values = {name: on_board.value(name) for name in inputs}
    examples = {name: torch.ones(v.sized(sizes), dtype=v.dtype) for name, v in values.items()}
    write(traced(step, examples, gives, [dynamic], REFINER), path, axes, about)
