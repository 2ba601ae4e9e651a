"""The names of the known architectures, read without importing any of them.

An architecture is one object that meets ``pipeline.networks.architecture.Architecture``, named
by an entry point of the group ``prolearn.architectures``. Any installed distribution may add one.
"""

from importlib.metadata import entry_points
from typing import Any

from pipeline.errors import InputError

GROUP = "prolearn.architectures"


def architecture_names() -> tuple[str, ...]:
    """Names of all installed architectures, in alphabetical order."""
    return tuple(sorted(entry_points(group=GROUP).names))


def distribution_of(name: str) -> str | None:
    """Name of the distribution that brings an architecture, where that is known.

    InputError for an unknown architecture.
    """
    found = getattr(entry_point(name), "dist", None)
    return None if found is None else str(found.name)


def entry_point(name: str) -> Any:
    """Where the architecture of a name is; some packages bring a class of their own for it.

    InputError for an unknown name, with the known ones.
    """
    for found in entry_points(group=GROUP):
        if found.name == name:
            return found
    known = ", ".join(architecture_names()) or "none: install prolearn again"
    raise InputError(f"architecture is {name!r}; expected one of those installed ({known}).")
