"""A model as one ONNX file, which is checked against torch before it takes its name."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch.export import Dim

from pipeline.errors import InputError, check_range
from pipeline.files import published
from pipeline.networks.architecture import find
from pipeline.networks.model import Model
from pipeline.networks.onboard import OnBoard, OnBoardFlown
from pipeline.networks.onnx_check import Checked, check
from pipeline.networks.onnx_files import traced, write
from pipeline.networks.supervised import Supervised
from pipeline.scenario.scenario import MOST_CRAFT

SCHEMA = "prolearn.onnx/1"

TRACED = 9
"""Craft with which the graph is traced: neither 0 nor 1, which torch treats as constants."""


@dataclass(frozen=True)
class Exported:
    """An ONNX file and what was measured of it.

    Attributes:
        path: the file.
        kib: its size, KiB.
        flown: whether it answers with transfers that can be flown, and their controls.
        checked: which swarms it answers for, how near it is to torch, and how fast.
    """

    path: Path
    kib: float
    flown: bool
    checked: Checked


def export(
    model: Model,
    path: Path,
    *,
    n: int | None = None,
    flown: bool = False,
    about: Mapping[str, Any] | None = None,
) -> Exported:
    """Write a model as one ONNX file that takes and gives m, m/s and m/s², float32.

    Inputs ``initial`` and ``goal``, (batch, n, 6); output ``states``, (batch, n, T, 6), and
    with ``flown`` also ``controls``, (batch, n, T-1, 3).

    Args:
        model: what to export.
        path: the file, replaced where it exists.
        n: craft that the file is for; by default any number that one graph of the architecture
            answers for.
        flown: project the prediction onto the transfers that can be flown.
        about: JSON values that are stored in the file's metadata.

    Raises:
        InputError: where onnx or onnxruntime is not installed, n is no number of craft, or the
            architecture answers in a way of its own.
        ProlearnError: where the architecture cannot be exported, or onnxruntime's answer is not
            torch's.
    """
    if n is not None:
        check_range("n", n, 1, MOST_CRAFT)
    outputs = ("states", "controls") if flown else ("states",)
    made = _traced(model, n, outputs)
    with published(path) as temporary:
        axes = dict.fromkeys(("initial", "goal", *outputs), ("batch", "n"))
        write(made, temporary, axes, {"schema": SCHEMA, **(about or {})})
        checked = check(temporary, model, n, flown=flown)
        kib = temporary.stat().st_size / 1024
    return Exported(path, kib, flown, checked)


def _traced(model: Model, n: int | None, outputs: Sequence[str]) -> torch.onnx.ONNXProgram:
    """The graph of a model."""
    architecture = find(model.architecture)
    if not isinstance(architecture, Supervised):
        raise InputError(
            f"architecture {model.architecture!r} answers with {model.answers} in a way of its "
            "own; expected one derived from pipeline.networks.supervised.Supervised, or refiner: "
            "these alone are exported."
        )
    module = (OnBoardFlown if "controls" in outputs else OnBoard)(architecture, model)
    craft = n or max(2, min(TRACED, model.n_train - 1))
    axes = {0: Dim.DYNAMIC} if n else {0: Dim.DYNAMIC, 1: Dim.AUTO}
    ends = {"initial": torch.ones(2, craft, 6), "goal": torch.zeros(2, craft, 6)}
    return traced(module, ends, outputs, (axes, axes), model.architecture)
