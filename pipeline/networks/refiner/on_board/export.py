"""A refiner as a folder of ONNX files, one for each step of a craft."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch.export import Dim

from pipeline.errors import InputError
from pipeline.files import published
from pipeline.networks.model import Model
from pipeline.networks.onnx_files import traced, write
from pipeline.networks.recipes import REFINER
from pipeline.networks.refiner.on_board.check import CraftCheck, check
from pipeline.networks.refiner.on_board.steps import (
    STEPS,
    Step,
    outputs,
    sizes_of,
    told_each_round,
    value,
)
from pipeline.networks.refiner.refiner import MessagePassing
from pipeline.scratch import scratch_folder

SCHEMA = "prolearn.onnx.craft/1"

ANY = {"P": 5, "Q": 4}  # axes of any length, and the length with which graphs are traced


@dataclass(frozen=True)
class ExportedCraft:
    """The files of one craft and what was measured of them."""

    folder: Path  # where they are, each named after its step
    kib: Mapping[str, float]  # size of each, by step, KiB
    sha256: Mapping[str, str]  # digest of each, by step
    told: Mapping[str, int]  # numbers told in each round for each live encounter, by name
    checked: CraftCheck  # how near they are to torch, and how fast


def export_craft(
    model: Model, folder: Path, *, about: Mapping[str, Any] | None = None
) -> ExportedCraft:
    """Write the steps that one craft of a refiner runs, as ``begin.onnx`` and so on.

    Files of these names are replaced; each has the JSON values ``about`` in its metadata.

    Raises:
        InputError: where onnx or onnxruntime is not installed, or the folder is a file.
        ProlearnError: where a step cannot be exported, or a swarm whose craft run them is not
            answered as by torch.
    """
    if folder.is_file():
        raise InputError(f"{folder} is a file; expected a folder for the files of a refiner.")
    network = model.network
    assert isinstance(network, MessagePassing), "a refiner's"
    with scratch_folder() as temporary:
        made = {name: temporary / f"{name}.onnx" for name in STEPS}
        for name, step in STEPS.items():
            described = {"schema": SCHEMA, "step": name, "tells": step.tells, **(about or {})}
            _write(step(network, model.problem), network.message, made[name], described)
        checked = check(made, model)
        content = {name: path.read_bytes() for name, path in made.items()}
    for name, graph in content.items():
        with published(folder / f"{name}.onnx") as path:
            path.write_bytes(graph)
    kib = {name: len(graph) / 1024 for name, graph in content.items()}
    digests = {name: hashlib.sha256(graph).hexdigest() for name, graph in content.items()}
    return ExportedCraft(folder, kib, digests, told_each_round(network.message), checked)


def _write(step: Step, message: int, path: Path, about: Mapping[str, Any]) -> None:
    """The file of a step."""
    sizes = sizes_of(step.problem.nodes, message, ANY["P"], ANY["Q"])
    inputs, gives = step.takes, outputs(type(step))
    axes = {
        name: [letter if letter in ANY else None for letter in value(name).shape]
        for name in (*inputs, *gives)
    }
    dynamic = tuple({k: Dim.DYNAMIC for k, a in enumerate(axes[name]) if a} for name in inputs)
    examples = {name: value(name).example(sizes) for name in inputs}
    write(traced(step, examples, gives, [dynamic], REFINER), path, axes, about)
