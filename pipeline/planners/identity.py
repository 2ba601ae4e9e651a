"""What decides the plans of a planner, as a value that files can hold."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

from pipeline.planners.planner import Planner


def identity(planner: Planner) -> dict[str, Any]:
    """Name, class, settings and digest of the network of a planner, JSON-ready.

    Planners with the same identity give the same plans where the versions of the code are the
    same.
    """
    return {"name": planner.name, **_told(planner)}


def _told(value: Any) -> Any:
    if value is None or isinstance(value, str | int | float):
        return value
    if isinstance(value, Mapping):
        return {str(key): _told(one) for key, one in value.items()}
    if isinstance(value, Sequence):
        return [_told(one) for one in value]
    if isinstance(getattr(value, "digest", None), str):  # a network
        return {"class": type(value).__qualname__, "digest": value.digest}
    if is_dataclass(value):
        told = {field.name: _told(getattr(value, field.name)) for field in fields(value)}
        return {"class": type(value).__qualname__, **told}
    kind = value if hasattr(value, "__qualname__") else type(value)
    return f"{kind.__module__}.{kind.__qualname__}"
