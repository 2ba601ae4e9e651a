"""A registered model as a file for on-board use, with its model card beside it."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from cli.jobs.cards import BY_SIZE, Measured, craft_card, model_card
from pipeline.errors import InputError
from pipeline.files import write_text
from pipeline.networks.model import load as load_network
from pipeline.networks.onnx_export import Exported
from pipeline.networks.onnx_export import export as export_onnx
from pipeline.networks.recipes import REFINER
from pipeline.networks.refiner.on_board.export import ExportedCraft, export_craft
from pipeline.networks.refiner.packaged import FOLDER
from registry.models import load
from registry.training import model_metric_by_size
from registry.version import PREFIX, ModelVersion

PACKAGED = "packaged"
"""The refiner that comes with the package, which is in no registry."""


@dataclass(frozen=True)
class ExportedModel:
    """The files of an exported model.

    Attributes:
        file: the ONNX file, or a refiner's folder of them, and what was measured of it.
        card: the model card.
    """

    file: Exported | ExportedCraft
    card: Path


def file_name(version: ModelVersion | None) -> str:
    """Default name of the file of a model, or of the packaged refiner."""
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
    model, version = (load_network(FOLDER), None) if reference is None else load(reference)
    known: dict[str, str] = {"uri": PACKAGED}
    measured: Measured = {}
    if version is not None:
        measured = {name: model_metric_by_size(version, name) for name in BY_SIZE}
        known = {
            "uri": version.uri,
            "run_id": version.run_id,
            "dataset_digest": version.dataset_digest,
        }
    about = {
        **known,
        "arch": model.architecture,
        "recipe": model.recipe,
        "n_spacecraft": model.n_train,
        "mean_motion": model.problem.mean_motion,
        "time_step": model.problem.time_step,
        "nodes": model.problem.nodes,
        "units": {"states": "m, m/s", "controls": "m/s^2"},
    }
    path = out or Path(file_name(version))
    made: Exported | ExportedCraft
    if version is None or model.architecture == REFINER:
        if n is not None or flown:
            raise InputError(
                f"--n or --flown is given for {version.name if version else PACKAGED}; expected "
                "neither: its files are those of one craft of any swarm, and give controls that "
                "can be flown."
            )
        path = path.with_suffix("") if path.suffix == ".onnx" else path
        made = export_craft(model, path, about=about)
        text = craft_card(version, model, made, measured)
    else:
        made = export_onnx(model, path, n=n, flown=flown, about=about)
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        text = model_card(version, model, made, measured, digest)
    card = path.with_name(path.name + ".md")
    write_text(card, text)
    return ExportedModel(made, card)
