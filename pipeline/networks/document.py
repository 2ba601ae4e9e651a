"""Stored networks without torch: model.json (prolearn.model/1), weights, and their protocol."""

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, TypeVar, runtime_checkable

import numpy as np
from pydantic import Field, FiniteFloat, model_validator
from safetensors import SafetensorError

from pipeline.arrays import Array, Float
from pipeline.documents import CHECKSUM, Strict, read_document, without_checksum
from pipeline.errors import InputError
from pipeline.orbit.problem import Problem

WEIGHTS_FILE = "weights.safetensors"
DOCUMENT_FILE = "model.json"

# Most columns n·T of a batch: a few hundred MB in the widest network; and of the refiner on a GPU,
# which fewer leave idle, 4 GiB for dense swarms of ten
COLUMNS_AT_ONCE, COLUMNS_ON_DEVICE = 50_000, 1_000_000

Answer = Literal["states", "controls"]
EndStates = Float[Array, "b n 6"]  # states of the swarms of a batch at one end, m and m/s
Parsed = TypeVar("Parsed")


@runtime_checkable
class TrainedNetwork(Protocol):
    """What planners need of a trained network, whether it runs on torch or not."""

    @property
    def architecture(self) -> str:
        """The name of the network's architecture."""

    @property
    def problem(self) -> Problem:
        """The problem of its training data."""

    @property
    def answers(self) -> Answer:
        """What it predicts."""

    @property
    def digest(self) -> str:
        """SHA-256 of all that determines its answers."""

    def on(self, problem: Problem) -> "TrainedNetwork":
        """The same weights for another problem; InputError where they do not fit."""

    def answer(
        self, initial: EndStates, goal: EndStates, collision_radius: float
    ) -> Float[Array, "b n _ _"]:
        """States (b, n, T, 6), m and m/s, or controls (b, n, T-1, 3), m/s², for any n ≥ 1.

        InputError where both ends differ in shape or are not finite states of swarms.
        """


def portions(initial: Array, goal: Array, nodes: int, device: str | None = None) -> Iterator[slice]:
    """Slices of swarms into batches that fit in memory, larger on a ``device``; at least one.

    InputError for wrong shapes and for values that are not finite.
    """
    n, components = initial.shape[-2:]
    if initial.shape != goal.shape or initial.ndim != 3 or n < 1 or components != 6:
        raise InputError(
            f"initial has shape {initial.shape} and goal {goal.shape}; expected (N, n, 6) for "
            "both, with at least one spacecraft."
        )
    for name, states in {"initial": initial, "goal": goal}.items():
        if not np.isfinite(states).all():
            raise InputError(
                f"{name} has values that are not finite; expected states in m and m/s."
            )
    step = max(1, (COLUMNS_AT_ONCE if device is None else COLUMNS_ON_DEVICE) // (n * nodes))
    for start in range(0, max(1, len(initial)), step):
        yield slice(start, start + step)


PositiveNumber = Annotated[FiniteFloat, Field(gt=0)]
Scale = Annotated[list[PositiveNumber], Field(min_length=6, max_length=6)]


class ProblemFields(Strict, strict=True):
    """The problem of the training data."""

    mean_motion: PositiveNumber
    time_step: PositiveNumber
    nodes: int = Field(ge=3)
    collision_radius: PositiveNumber
    max_acceleration: PositiveNumber | None = None


class ModelDocument(Strict, strict=True, populate_by_name=True, serialize_by_alias=True):
    """The fields of a model file besides its checksum; unknown ones are refused."""

    schema_name: Literal["prolearn.model/1"] = Field(alias="schema", default="prolearn.model/1")
    architecture: str
    config: dict[str, Any]
    recipe: str
    problem: ProblemFields
    n_train: int = Field(ge=1)
    interior: str
    target: str
    input_scale: Scale
    target_scale: Scale
    weights_sha256: str

    @model_validator(mode="before")
    @classmethod
    def _undamaged(cls, fields: Any) -> Any:
        """Refuse fields whose checksum is wrong; earlier versions wrote none."""
        checked = isinstance(fields, dict) and CHECKSUM in fields
        return without_checksum(fields) if checked else fields

    @property
    def digest(self) -> str:
        """SHA-256 of the fields, and so of the weights too."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()


def read_model(folder: Path) -> ModelDocument:
    """The model.json of a folder; InputError where it is missing, damaged or of another schema."""
    what = "a model of schema prolearn.model/1: update prolearn or train the model again"
    return read_document(folder / DOCUMENT_FILE, ModelDocument, what)


def read_weights(folder: Path, digest: str, parse: Callable[[bytes], Parsed]) -> Parsed:
    """The weights in a folder; InputError where missing, damaged or not those of the digest."""
    path = folder / WEIGHTS_FILE
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error}); expected weights.") from error
    if hashlib.sha256(content).hexdigest() != digest:
        raise InputError(
            f"{path} is not the file that {DOCUMENT_FILE} was written for (weights_sha256 "
            "differs); copy the model again or train it again."
        )
    try:
        return parse(content)
    except (SafetensorError, KeyError, ValueError) as error:
        raise InputError(
            f"{path} holds no safetensors ({error}); train the model again."
        ) from error
