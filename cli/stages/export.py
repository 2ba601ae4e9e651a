"""A registered model as a file for on-board use, with its model card beside it."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from cli.stages.card import BY_SIZE, model_card
from pipeline.files import write_text
from pipeline.networks.onnx_export import Exported
from pipeline.networks.onnx_export import export as export_onnx
from registry.models import load
from registry.results import model_metric_by_size
from registry.version import ModelVersion


@dataclass(frozen=True)
class ExportedModel:
    """What an export left.

    Attributes:
        file: the ONNX file and what was measured of it.
        card: the model card.
    """

    file: Exported
    card: Path


def file_name(version: ModelVersion) -> str:
    """What the file of a model is called where nobody names it."""
    return f"{version.name}-v{version.version}.onnx"


def export(
    reference: str | ModelVersion,
    out: Path | None = None,
    *,
    n: int | None = None,
    flown: bool = False,
) -> ExportedModel:
    """Export a registered model as ONNX, and write its card as ``<out>.md``.

    Args:
        reference: the model.
        out: the file; ``<name>-v<version>.onnx`` in the current folder by default.
        n: craft that it is for, or any number that the architecture answers for.
        flown: project the prediction onto the transfers that can be flown.

    Raises:
        InputError: where there is no such model, or onnx and onnxruntime are not installed.
        ProlearnError: where the store fails, or the file does not answer as the model does.
    """
    model, version = load(reference)
    measured = {name: model_metric_by_size(version, name) for name in BY_SIZE}
    about = {
        "uri": version.uri,
        "run_id": version.run_id,
        "arch": version.arch,
        "recipe": version.recipe,
        "dataset_digest": version.dataset_digest,
        "n_spacecraft": model.n_train,
        "mean_motion": model.problem.mean_motion,
        "time_step": model.problem.time_step,
        "nodes": model.problem.nodes,
        "units": {"states": "m, m/s", "controls": "m/s^2"},
    }
    path = out or Path(file_name(version))
    file = export_onnx(model, path, n=n, flown=flown, about=about)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    card = path.with_name(path.name + ".md")
    write_text(card, model_card(version, model, file, measured, digest))
    return ExportedModel(file, card)
