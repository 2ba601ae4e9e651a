"""Export of a model as one ONNX file, compared with torch before it is written."""

import json
import logging
import math
import timeit
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.export import Dim

from pipeline.arrays import Array, Float
from pipeline.errors import InputError, ProlearnError, check_range, missing_extra_hint
from pipeline.files import published
from pipeline.networks.architecture import find
from pipeline.networks.document import EndStates
from pipeline.networks.encoding import INTERIORS, Encoding
from pipeline.networks.model import Model
from pipeline.networks.supervised import Supervised
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly, project_to_flyable
from pipeline.scenario.scenario import MOST_CRAFT
from pipeline.text import first_line

SCHEMA = "prolearn.onnx/1"
TRACED = 9  # craft with which the graph is traced: neither 0 nor 1, which torch treats as constants
TOLERANCE = 1e-5  # largest difference from torch, as a share of a component's root mean square
SIZES = (1, 2, 10, 30, 100)  # swarm sizes that are checked and timed, where the file serves them
INSTANCES = 4  # random swarms of each size that are compared
WARM_UP, REPEATS = 5, 50  # calls before the timed ones, and timed calls

# Names of axes of any length, by input or output; None for an axis of fixed length
Axes = Mapping[str, Sequence[str | None]]


@dataclass(frozen=True)
class Exported:
    """An ONNX file, its accuracy and its speed."""

    path: Path
    kib: float  # its size, KiB
    flown: bool  # whether its answers are transfers that can be flown, with their controls
    n: int | None  # the only number of craft that the file answers for, or None
    most: int | None  # the largest number that it answers for, or None where there is no limit
    difference: float  # largest difference from torch, as a share of a component's root mean square
    metres: float  # largest difference of a position, m
    seconds: Mapping[int, float]  # median time of one instance on one core, by swarm size

    @property
    def sizes(self) -> str:
        """The swarm sizes that the file answers for, in words."""
        if self.n is not None:
            return f"n = {self.n}"
        return "any n" if self.most is None else f"n = 1 to {self.most}"


def _check(path: Path, model: Model, n: int | None, *, flown: bool) -> Exported:
    """Compare a file with torch on random swarms, and find the largest swarm that it serves."""
    session = open_session(path)
    most = n
    sizes = sorted({*SIZES, model.n_train}) if n is None else [n]
    found = {size: _difference(session, model, size, flown=flown) for size in sizes}
    if n is None and max(found.values())[0] > TOLERANCE:  # what serves any n must serve all sizes
        most = model.n_train
        found = {size: difference for size, difference in found.items() if size <= most}
    shares, metres = (max(values) for values in zip(*found.values(), strict=True))
    if shares > TOLERANCE:
        raise ProlearnError(
            f"onnxruntime's answer differs from torch's by {shares:.2g} of a component's root "
            f"mean square; expected at most {TOLERANCE:g}: the file was not written."
        )
    seconds = {size: _seconds(session, model, size) for size in found}
    return Exported(path, path.stat().st_size / 1024, flown, n, most, shares, metres, seconds)


def _ends(model: Model, n: int, instances: int) -> dict[str, EndStates]:
    """Random end states as large as the training data's, in float32."""
    scale = np.array(model.encoding.input_scale)
    drawn = np.random.default_rng(n).normal(size=(2, instances, n, 6)) * scale
    return dict(zip(("initial", "goal"), drawn.astype(np.float32), strict=True))


def _difference(session: Any, model: Model, n: int, *, flown: bool) -> tuple[float, float]:
    """``difference`` and ``metres`` of ``Exported``; infinite where the file does not answer."""
    ends = _ends(model, n, INSTANCES)
    try:
        given: Sequence[Array] = session.run(None, ends)
    except Exception:  # onnxruntime's own kinds, all directly under Exception
        return math.inf, math.inf
    initial, goal = (end.astype(np.float64) for end in ends.values())
    predicted = model.predict(initial, goal)
    wanted = [predicted]
    if flown:
        controls = project_to_flyable(predicted, initial, goal, model.problem)
        wanted = [fly(initial, controls, model.problem), controls]
    if [g.shape for g in given] != [w.shape for w in wanted]:
        return math.inf, math.inf
    shares = [
        np.abs(g - w).max(axis=(0, 1, 2)) / np.sqrt(np.square(w).mean(axis=(0, 1, 2)))
        for g, w in zip(given, wanted, strict=True)
    ]
    metres = np.abs(given[0] - wanted[0])[..., :3].max()
    return float(np.concatenate(shares).max()), float(metres)


def _seconds(session: Any, model: Model, n: int) -> float:
    """Median time of one instance in s, after a few calls to warm up."""
    call = partial(session.run, None, _ends(model, n, 1))
    return float(np.median(timeit.repeat(call, number=1, repeat=WARM_UP + REPEATS)[WARM_UP:]))


class ExportedGraph(nn.Module):
    """The exported graph, float32: encoding, network, decoding, projection if ``flown``."""

    read: Tensor  # linear map from both end states of a craft to its input trajectory, (12, 6T)
    flyable: Tensor  # from predicted states and both ends to flown ones and controls

    def __init__(self, architecture: Supervised, model: Model, *, flown: bool) -> None:
        super().__init__()
        self.architecture, self.encoding, self.network = architecture, model.encoding, model.network
        self.flown = flown
        self.register_buffer("read", torch.from_numpy(_input_map(model.encoding)).float())
        if flown:
            self.register_buffer("flyable", torch.from_numpy(_flyable_map(model.problem)))

    def forward(
        self, initial: Float[Tensor, "b n 6"], goal: Float[Tensor, "b n 6"]
    ) -> tuple[Tensor, ...]:
        """Node states (b, n, T, 6), m and m/s; if flown also controls (b, n, T-1, 3), m/s²."""
        ends, T = torch.cat([initial, goal], dim=-1), self.encoding.problem.nodes  # (b, n, 12)
        inputs = (ends @ self.read).reshape(*initial.shape[:2], T, 6)
        output = self.architecture.forward(self.network, inputs, self.encoding)
        predicted = self.encoding.decode(output, inputs)
        if not self.flown:
            return (predicted,)
        known = torch.cat([predicted.flatten(2), ends], dim=-1).double()
        # In float64: what the controls reach is a small difference of large terms.
        flown = (known @ self.flyable).float()  # (b, n, 6T + 3(T-1))
        states, controls = flown[..., : 6 * T], flown[..., 6 * T :]
        return states.reshape(predicted.shape), controls.reshape(*initial.shape[:2], T - 1, 3)


def _input_map(encoding: Encoding) -> Float[Array, "12 _"]:
    """Linear map from both end states of a craft to its encoded input."""
    unit = np.eye(12)
    given = INTERIORS[encoding.interior](unit[:, :6], unit[:, 6:], encoding.problem)
    return (given / np.array(encoding.input_scale)).reshape(12, -1)


def _flyable_map(problem: Problem) -> Float[Array, "_ _"]:
    """Linear map from predicted states and both ends of a craft to flown states and controls."""
    T = problem.nodes
    unit = np.eye(6 * T + 12)
    states, initial, goal = np.split(unit, [6 * T, 6 * T + 6], axis=1)
    controls = project_to_flyable(states.reshape(-1, T, 6), initial, goal, problem)
    flown = fly(initial, controls, problem)
    return np.hstack([flown.reshape(len(unit), -1), controls.reshape(len(unit), -1)])


def export(
    model: Model,
    path: Path,
    *,
    n: int | None = None,
    flown: bool = False,
    about: Mapping[str, Any] | None = None,
) -> Exported:
    """Write a model as one ONNX file that takes and gives m, m/s and m/s², float32.

    Inputs ``initial`` and ``goal``, (batch, n, 6); output ``states``, (batch, n, T, 6), and with
    ``flown`` also ``controls``, (batch, n, T-1, 3).

    The file is for n craft, or for any number that one graph of the architecture answers for.
    ``flown`` projects the prediction onto the transfers that can be flown; the file's metadata has
    the JSON values ``about``. InputError where onnx or onnxruntime is not installed, n is no number
    of craft, or the architecture is not derived from ``Supervised``. ProlearnError where it cannot
    be exported, or onnxruntime's answer is not torch's.
    """
    if n is not None:
        check_range("n", n, 1, MOST_CRAFT)
    architecture = find(model.architecture)
    if not isinstance(architecture, Supervised):
        raise InputError(
            f"architecture {model.architecture!r} answers with {model.answers} in a way of its "
            "own; expected one derived from pipeline.networks.supervised.Supervised, or refiner: "
            "these alone are exported."
        )
    outputs = ("states", "controls") if flown else ("states",)
    module = ExportedGraph(architecture, model, flown=flown)
    with published(path) as temporary:
        try:
            made = _traced_for(n, module, outputs, model)
        except ProlearnError:
            if n is not None or model.n_train > 1:
                raise
            n = 1  # all that a feed-forward network of one craft answers for without averages
            made = _traced_for(n, module, outputs, model)
        axes = dict.fromkeys(("initial", "goal", *outputs), ("batch", "n"))
        write(made, temporary, axes, {"schema": SCHEMA, **(about or {})})
        exported = _check(temporary, model, n, flown=flown)
    return replace(exported, path=path)


def _traced_for(
    n: int | None, module: ExportedGraph, outputs: Sequence[str], model: Model
) -> torch.onnx.ONNXProgram:
    """Trace a network for n craft or, by default, with an axis of any number of craft."""
    craft = n or max(2, min(TRACED, model.n_train - 1))
    free = {0: Dim.DYNAMIC} if n else {0: Dim.DYNAMIC, 1: Dim.AUTO}
    ends = {"initial": torch.ones(2, craft, 6), "goal": torch.zeros(2, craft, 6)}
    return traced(module, ends, outputs, (free, free), model.architecture)


# Files by torch's exporter, and how they are run on one core.


def traced(
    module: nn.Module,
    examples: Mapping[str, Tensor],
    outputs: Sequence[str],
    dynamic: Sequence[Any],
    name: str,
) -> torch.onnx.ONNXProgram:
    """The graph of a module by torch.export, traced with example inputs by name.

    ``dynamic`` has the axes of each input of any length; ``name`` is the architecture's. InputError
    where onnxscript is not installed. ProlearnError where torch cannot trace the module.
    """
    with missing_extra_hint():
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
        why = first_line(error.__cause__ or error)  # its exporter tells the step that failed
        raise ProlearnError(
            f"architecture {name!r} cannot be exported ({why}); expected a forward pass that "
            "torch.export.export can trace."
        ) from error
    assert made is not None, "the exporter that uses torch.export returns a program"
    return made


def write(made: torch.onnx.ONNXProgram, path: Path, axes: Axes, about: Mapping[str, Any]) -> None:
    """Write the file, with named axes and a description in its metadata."""
    import onnx

    for node in made.model.graph.all_nodes():
        node.metadata_props.clear()  # where in the source each node comes from
    proto = made.model_proto
    proto.graph.ClearField("value_info")  # shapes in between, which all that read files find again
    for value in (*proto.graph.input, *proto.graph.output):
        for axis, name in zip(value.type.tensor_type.shape.dim, axes[value.name], strict=False):
            if name is not None and axis.HasField("dim_param"):
                axis.dim_param = name
    onnx.helper.set_model_props(proto, {"prolearn": json.dumps(dict(about), sort_keys=True)})
    onnx.checker.check_model(proto, full_check=True)
    path.write_bytes(proto.SerializeToString())


def open_session(path: Path) -> Any:
    """An onnxruntime session on one core; InputError where that is not installed."""
    with missing_extra_hint():
        import onnxruntime
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # a swarm size that the file does not serve is expected
    return onnxruntime.InferenceSession(
        path.read_bytes(), sess_options=options, providers=["CPUExecutionProvider"]
    )


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence warnings of torch and its exporter about features that are not used here."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        logging.disable(before)
