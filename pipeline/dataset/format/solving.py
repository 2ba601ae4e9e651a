"""How the plans of a dataset are made, as its manifest and its shards record it."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from pydantic import TypeAdapter, ValidationError

from pipeline.documents import first_fault
from pipeline.errors import InputError
from pipeline.expert import Settings
from pipeline.plan import Requirements

FORMER_SOLVERS = {"cvxpy": "clarabel"}
"""What earlier versions could solve a dataset by, and what is called for instead now."""

REQUIRED = ("separation", "passive_safety")
"""Requirements that are recorded, beside the settings of the expert."""


def recorded(settings: Settings, requirements: Requirements) -> Mapping[str, Any]:
    """Settings of the expert and what its plans must satisfy, by name.

    Raises:
        InputError: where a risk is asked for, which no column of a dataset shows.
    """
    if requirements.risk is not None:
        raise InputError(
            "a risk is asked for of a dataset, whose plans are flown without errors; expected "
            "requirements without one."
        )
    return asdict(settings) | {name: getattr(requirements, name) for name in REQUIRED}


def settings_of(record: Mapping[str, Any]) -> Settings:
    """The settings of the expert in a record."""
    return Settings(**{k: v for k, v in _now(record).items() if k not in REQUIRED})


def _now(record: Mapping[str, Any]) -> Mapping[str, Any]:
    """A record by the solvers that there are now."""
    solver = record.get("solver")
    return {**record, "solver": FORMER_SOLVERS[solver]} if solver in FORMER_SOLVERS else record


def requirements_of(record: Mapping[str, Any]) -> Requirements:
    """What plans must satisfy by a record.

    Raises:
        ValueError: where that is nothing a plan can satisfy.
    """
    told = {name: record[name] for name in REQUIRED if name in record}
    return TypeAdapter(Requirements).validate_python(told) and Requirements(**told)


def checked_record(given: Mapping[str, Any]) -> Mapping[str, Any]:
    """A record as it is written, where it is one.

    Raises:
        ValueError: naming what is wrong with it.
    """
    try:
        TypeAdapter(Settings).validate_python(_now(given))
        settings_of(given), requirements_of(given)
    except ValidationError as error:
        raise ValueError(first_fault(error)) from None
    except TypeError as error:  # a name that is none
        raise ValueError(str(error)) from None
    return given
