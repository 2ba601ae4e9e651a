"""A registered model as a file for on-board use, with its model card beside it."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cli.stages.card import BY_SIZE, model_card
from cli.stages.craft_card import craft_card
from pipeline.errors import InputError
from pipeline.files import write_text
from pipeline.networks.model import Model
from pipeline.networks.onnx_export import Exported
from pipeline.networks.onnx_export import export as export_onnx
from pipeline.networks.refiner.ablations import REFINER
from pipeline.networks.refiner.on_board.export import ExportedCraft, export_craft
from pipeline.networks.refiner.packaged import packaged
from registry.model_metrics import model_metric_by_size
from registry.models import load
from registry.version import PREFIX, ModelVersion

PACKAGED = "packaged"
"""The refiner that comes with the package, which is in no registry."""


@dataclass(frozen=True)
class ExportedModel:
    """What an export left.

    Attributes:
        file: the ONNX file, or a refiner's folder of them, and what was measured of it.
        card: the model card.
    """

    file: Exported | ExportedCraft
    card: Path


def file_name(version: ModelVersion | None) -> str:
    """What the file of a model, or of the packaged refiner, is called where nobody names it."""
    if version is None:
        return f"{PREFIX}{REFINER}-{PACKAGED}.onnx"
    return f"{version.name}-v{version.version}.onnx"


def export(
    reference: str | ModelVersion | None,
    out: Path | None = None,
    *,
    n: int | None = None,
    flown: bool = False,
) -> ExportedModel:
    """Export a registered model or the packaged refiner as ONNX, its card as ``<out>.md``.

    A refiner becomes a folder of files, named as the file would be but without ``.onnx``.

    Args:
        reference: the model; None for the packaged refiner, which needs no store.
        out: the file; ``<name>-v<version>.onnx`` in the current folder by default.
        n: craft that it is for, or any number that the architecture answers for.
        flown: project the prediction onto the transfers that can be flown.

    Raises:
        InputError: where there is no such model, onnx and onnxruntime are not installed, or a
            refiner is asked for n or flown.
        ProlearnError: where the store fails, or the file does not answer as the model does.
    """
    model, version = (packaged(), None) if reference is None else load(reference)
    about = {
        **({"uri": PACKAGED} if version is None else _registered(version)),
        "arch": model.architecture,
        "recipe": model.recipe,
        "n_spacecraft": model.n_train,
        "mean_motion": model.problem.mean_motion,
        "time_step": model.problem.time_step,
        "nodes": model.problem.nodes,
        "units": {"states": "m, m/s", "controls": "m/s^2"},
    }
    path = out or Path(file_name(version))
    measured = (
        {} if version is None else {name: model_metric_by_size(version, name) for name in BY_SIZE}
    )
    if version is None or model.architecture == REFINER:
        return _export_craft(model, version, path, measured, about, asked=n is not None or flown)
    file = export_onnx(model, path, n=n, flown=flown, about=about)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    card = path.with_name(path.name + ".md")
    write_text(card, model_card(version, model, file, measured, digest))
    return ExportedModel(file, card)


def _registered(version: ModelVersion) -> dict[str, Any]:
    """Where a model is known by what."""
    return {
        "uri": version.uri,
        "run_id": version.run_id,
        "dataset_digest": version.dataset_digest,
    }


def _export_craft(
    model: Model,
    version: ModelVersion | None,
    path: Path,
    measured: Mapping[str, Mapping[int, float]],
    about: Mapping[str, Any],
    *,
    asked: bool,
) -> ExportedModel:
    """The files of one craft of a refiner, and their card."""
    if asked:
        raise InputError(
            f"--n or --flown is given for {version.name if version else PACKAGED}; expected "
            "neither: its files are those of one craft of any swarm, and give controls that can be "
            "flown."
        )
    files = export_craft(
        model, path.with_suffix("") if path.suffix == ".onnx" else path, about=about
    )
    card = files.folder.with_name(files.folder.name + ".md")
    write_text(card, craft_card(version, model, files, measured))
    return ExportedModel(files, card)
