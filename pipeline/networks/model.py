"""Trained models: prediction for swarms, and storage in a folder."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import load as tensors_from
from safetensors.torch import save as tensors_to
from torch import Tensor, nn

from pipeline.arrays import Array, Float
from pipeline.documents import with_checksum, write_document
from pipeline.errors import InputError
from pipeline.files import published
from pipeline.networks import document as stored
from pipeline.networks.architecture import find, swarms
from pipeline.networks.document import Answer, EndStates, portions
from pipeline.networks.encoding import Encoding
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly

NO_NETWORK = (ValueError, TypeError, KeyError, RuntimeError)
"""What an architecture raises where a configuration is not one of a network."""


@dataclass(frozen=True, eq=False)
class Model:
    """A trained network with all that is needed to use it."""

    architecture: str  # its name
    config: Mapping[str, Any]  # its sizes
    recipe: str  # name of the recipe that it was trained by
    encoding: Encoding  # of states as its input, and of its output as states
    network: nn.Module  # the module, for answers only
    device: str | None = None  # on which a refiner plans, as in ``TrainedRefiner``

    def __post_init__(self) -> None:
        """Switch off what only training needs: dropout and gradients."""
        self.network.eval().requires_grad_(False)

    @property
    def problem(self) -> Problem:
        """The problem of its training data."""
        return self.encoding.problem

    @property
    def n_train(self) -> int:
        """Spacecraft in each instance of its training data."""
        return self.encoding.n

    @property
    def digest(self) -> str:
        """SHA-256 of all that determines its answers."""
        return _documented(self)[1].digest

    def on(self, problem: Problem) -> "Model":
        """The same weights and scales for another problem; InputError where they do not fit."""
        encoding = replace(self.encoding, problem=problem)
        try:
            network = _skeleton(self.architecture, self.config, encoding)
            network.load_state_dict(self.network.state_dict(), assign=True)
        except NO_NETWORK as error:
            known = self.problem
            raise InputError(
                f"the weights of the network {self.architecture}, trained with nodes {known.nodes} "
                f"and time_step {known.time_step:.9g}, do not fit nodes {problem.nodes} and "
                f"time_step {problem.time_step:.9g}; expected a problem that they fit: train on "
                "data of this kind, or take a network whose size does not depend on the time grid, "
                "such as lstm1."
            ) from error
        return replace(self, encoding=encoding, network=network)

    @property
    def answers(self) -> Answer:
        """What it predicts: "states" or "controls"."""
        return find(self.architecture).answers

    def predict(self, initial: EndStates, goal: EndStates) -> Float[Array, "b n T 6"]:
        """Predicted node states, m and m/s, with the collision radius of the training data.

        Predicted states obey no dynamics; predicted controls are flown, and may miss the goal.
        Swarms may have any n ≥ 1 craft; errors are those of ``answer``.
        """
        answer = self.answer(initial, goal, self.problem.collision_radius)
        return answer if self.answers == "states" else fly(initial, answer, self.problem)

    def answer(
        self, initial: EndStates, goal: EndStates, collision_radius: float
    ) -> Float[Array, "b n _ _"]:
        """As in ``TrainedNetwork``."""
        problem, found = replace(self.problem, collision_radius=collision_radius), []
        with torch.inference_mode():
            for part in portions(initial, goal, problem.nodes, self.device):
                batch = replace(swarms(problem, initial[part], goal[part]), device=self.device)
                answer = find(self.architecture).answer(self.network, batch, self.encoding)
                found.append(answer.double().cpu().numpy())
        return np.concatenate(found)


def save(model: Model, folder: Path) -> None:
    """Write ``weights.safetensors``, then ``model.json`` with their digest and its own checksum."""
    weights, document = _documented(model)
    with published(folder / stored.WEIGHTS_FILE) as temporary:
        temporary.write_bytes(weights)
    write_document(folder / stored.DOCUMENT_FILE, with_checksum(document.model_dump(mode="json")))


def _documented(model: Model) -> tuple[bytes, stored.ModelDocument]:
    """The weights as bytes, and the document with their digest."""
    weights = tensors_to({k: v.contiguous() for k, v in model.network.state_dict().items()})
    encoding = model.encoding
    document = stored.ModelDocument(
        architecture=model.architecture,
        config=dict(model.config),
        recipe=model.recipe,
        problem=stored.ProblemFields(**encoding.problem.document()),
        n_train=encoding.n,
        interior=encoding.interior,
        target=encoding.target,
        input_scale=list(encoding.input_scale),
        target_scale=list(encoding.target_scale),
        weights_sha256=hashlib.sha256(weights).hexdigest(),
    )
    return weights, document


def load(folder: Path) -> Model:
    """The model that ``save`` wrote; InputError where files are missing, damaged or do not fit."""
    document = stored.read_model(folder)
    encoding = Encoding(
        problem=Problem(**document.problem.model_dump()),
        n=document.n_train,
        interior=document.interior,
        target=document.target,
        input_scale=tuple(document.input_scale),
        target_scale=tuple(document.target_scale),
    )
    try:
        network = _skeleton(document.architecture, document.config, encoding)
    except NO_NETWORK as error:
        raise InputError(
            f"{folder / stored.DOCUMENT_FILE}: config is {document.config}, of which architecture "
            f"{document.architecture!r} makes no network; train the model again."
        ) from error
    weights = stored.read_weights(folder, document.weights_sha256, tensors_from)
    _check_weights(folder / stored.WEIGHTS_FILE, weights, network.state_dict())
    network.load_state_dict(weights, assign=True)
    return Model(document.architecture, document.config, document.recipe, encoding, network)


def _skeleton(architecture: str, config: Mapping[str, Any], encoding: Encoding) -> nn.Module:
    """The network on torch's meta device, so that no file can ask for too much memory."""
    found = find(architecture)
    with torch.device("meta"):
        return found.network(config, encoding, 0.0)


def _check_weights(path: Path, given: Mapping[str, Tensor], wanted: Mapping[str, Tensor]) -> None:
    if given.keys() != wanted.keys():
        odd = ", ".join(sorted(given.keys() ^ wanted.keys()))
        raise InputError(f"{path} does not have the network's weights; missing or unknown: {odd}.")
    for name, tensor in given.items():
        like = wanted[name]
        if tensor.shape != like.shape or tensor.dtype != like.dtype:
            raise InputError(
                f"{path}: {name} is {tensor.dtype} of shape {tuple(tensor.shape)}; expected "
                f"{like.dtype} of shape {tuple(like.shape)}."
            )
        if not torch.isfinite(tensor).all():
            raise InputError(f"{path}: {name} has values that are not finite numbers; train again.")
