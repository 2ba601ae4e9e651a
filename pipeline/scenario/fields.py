"""Field types of scenario files, and their validators."""

from dataclasses import fields
from datetime import UTC, datetime
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, FiniteFloat
from pydantic_core import to_jsonable_python

from pipeline.orbit.reference import is_epoch


def one_of(**fields: str) -> dict[str, Any]:
    """JSON Schema's condition that exactly one of some fields is given, each with its JSON type."""
    forms = [
        {"required": [name], "properties": {name: {"type": kind}}} for name, kind in fields.items()
    ]
    return {"oneOf": forms}


def number(given: Any) -> Any:
    """Refuse text and booleans where a number is expected."""
    if isinstance(given, str | bool):
        raise ValueError("expected a number, without quotes")
    return given


def given_fields(value: Any) -> dict[str, Any]:
    """The fields of a dataclass that are not at their defaults, as JSON values."""
    every = {field.name: (getattr(value, field.name), field.default) for field in fields(value)}
    return {name: to_jsonable_python(one) for name, (one, usual) in every.items() if one != usual}


def utc(given: Any) -> datetime:
    """The time, UTC, of an ISO 8601 text; ValueError for one without a zone."""
    try:
        epoch = datetime.fromisoformat(given)
    except (TypeError, ValueError):
        epoch = None
    if epoch is None or not is_epoch(epoch):
        raise ValueError("give date, time and zone by ISO 8601, such as 2026-03-01T12:00:00Z")
    return epoch.astimezone(UTC)


Number = Annotated[FiniteFloat, Field(strict=True)]
Whole = Annotated[int, BeforeValidator(number)]
Positive = Annotated[Number, Field(gt=0)]
State = Annotated[list[Number], Field(min_length=6, max_length=6)]
StateList = Annotated[
    list[State],
    Field(min_length=1, description="A state x y z vx vy vz of each craft, LVLH, m and m/s."),
]
Triple = tuple[Number, Number, Number]
NoBurn = Annotated[
    tuple[tuple[Number, Number], ...],
    Field(description="Stretches of time, from and to, s since the first node, without burns."),
]
