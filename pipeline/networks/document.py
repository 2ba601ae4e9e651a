"""model.json (schema prolearn.model/1): all of a trained model but its weights."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from pipeline.documents import CHECKSUM, without_checksum
from pipeline.networks.encoding import Encoding
from pipeline.orbit.problem import Problem

WHAT = "a model of schema prolearn.model/1: update prolearn or train the model again"

Positive = Annotated[FiniteFloat, Field(gt=0)]
Scale = Annotated[list[Positive], Field(min_length=6, max_length=6)]


class ProblemFields(BaseModel):
    """The problem of the training data."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    mean_motion: Positive
    time_step: Positive
    nodes: int = Field(ge=3)
    collision_radius: Positive
    max_acceleration: Positive | None = None


class ModelDocument(BaseModel):
    """The fields of a model file beside its checksum; unknown ones are refused."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, populate_by_name=True, serialize_by_alias=True
    )

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
        """Refuse fields that are not those of their checksum; earlier versions wrote none."""
        checked = isinstance(fields, dict) and CHECKSUM in fields
        return without_checksum(fields) if checked else fields

    @property
    def encoding(self) -> Encoding:
        """The encoding that the fields describe."""
        return Encoding(
            problem=Problem(**self.problem.model_dump()),
            n=self.n_train,
            interior=self.interior,
            target=self.target,
            input_scale=tuple(self.input_scale),
            target_scale=tuple(self.target_scale),
        )
