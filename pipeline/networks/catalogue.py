"""The names of the known architectures, entry points of a group, read without importing any."""

from importlib.metadata import entry_points
from typing import Any

from pipeline.errors import InputError

GROUP = "prolearn.architectures"


def architecture_names() -> tuple[str, ...]:
    """Names of all installed architectures, in alphabetical order."""
    return tuple(sorted(entry_points(group=GROUP).names))


def distribution_of(name: str) -> str | None:
    """The distribution that brings an architecture, where known; InputError for an unknown name."""
    found = getattr(entry_point(name), "dist", None)
    return None if found is None else str(found.name)


def entry_point(name: str) -> Any:
    """The entry point of an architecture; InputError, with the known names, for an unknown one."""
    for found in entry_points(group=GROUP):
        if found.name == name:
            return found
    known = ", ".join(architecture_names()) or "none: install prolearn again"
    raise InputError(f"architecture is {name!r}; expected one of those installed ({known}).")
