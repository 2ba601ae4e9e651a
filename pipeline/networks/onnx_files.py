"""ONNX files by torch's exporter, and how they are run on one core."""

import json
import logging
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from pipeline.errors import ProlearnError, told_which_extra

Axes = Mapping[str, Sequence[str | None]]
"""Names of the axes whose length may differ, by input or output; None for the others."""


def traced(
    module: nn.Module,
    examples: Mapping[str, Tensor],
    outputs: Sequence[str],
    dynamic: Sequence[Any],
    name: str,
) -> torch.onnx.ONNXProgram:
    """The graph of a module, traced with example inputs by name.

    ``dynamic`` has the axes of each input that may have any length, and ``name`` is that of the
    architecture, for messages. InputError where onnxscript is not installed. ProlearnError where
    torch cannot trace the module.
    """
    with told_which_extra():
        import onnxscript  # noqa: F401  (torch's exporter needs it)
    try:
        with _quiet(), torch.no_grad():
            made = torch.onnx.export(
                module.eval(),
                tuple(examples.values()),
                input_names=list(examples),
                output_names=list(outputs),
                dynamic_shapes=tuple(dynamic),
                dynamo=True,
                verbose=False,
            )
    except Exception as error:  # torch raises many kinds, some of them private
        raise ProlearnError(
            f"architecture {name!r} cannot be exported "
            f"({str(error).strip().splitlines()[0]}); expected a forward pass that "
            "torch.export.export can trace."
        ) from error
    assert made is not None, "the exporter that uses torch.export returns a program"
    return made


def write(made: torch.onnx.ONNXProgram, path: Path, axes: Axes, about: Mapping[str, Any]) -> None:
    """The file, with its axes named and a description in its metadata."""
    import onnx

    for node in made.model.graph.all_nodes():
        node.metadata_props.clear()  # where in the source each node comes from
    proto = made.model_proto
    for value in (*proto.graph.input, *proto.graph.output):
        for axis, name in zip(value.type.tensor_type.shape.dim, axes[value.name], strict=False):
            if name is not None and axis.HasField("dim_param"):
                axis.dim_param = name
    onnx.helper.set_model_props(proto, {"prolearn": json.dumps(dict(about), sort_keys=True)})
    onnx.checker.check_model(proto, full_check=True)
    path.write_bytes(proto.SerializeToString())


def open_session(path: Path) -> Any:
    """A file in onnxruntime, on one core; InputError where it is not installed."""
    with told_which_extra():
        import onnxruntime
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # a swarm that it does not answer for is no event
    return onnxruntime.InferenceSession(
        path.read_bytes(), sess_options=options, providers=["CPUExecutionProvider"]
    )


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence warnings of torch and its exporter about features that are not used here."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", category=Warning)
            yield
    finally:
        logging.disable(before)
