"""Hidden layers of the paper's architectures (Table 1)."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

MAX_WIDTH = 1_000_000
"""More neurons in a layer than this is a mistake."""

Width = Annotated[int, Field(ge=1, le=MAX_WIDTH, strict=True)]


class Layers(BaseModel):
    """Neurons of each hidden layer, in order."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    hidden: list[Width] = Field(min_length=1, max_length=100)


def hidden_layers(config: Mapping[str, Any]) -> list[int]:
    """The ``hidden`` of a configuration; ValueError where it makes no sense."""
    return Layers.model_validate(dict(config)).hidden
