"""What people call a model: ARCH, ARCH:RECIPE, NAME@ALIAS, NAME/VERSION or a models:/ URI."""

import re

from mlflow.exceptions import MlflowException

from pipeline.errors import InputError
from registry.store import Store, opened
from registry.version import CHAMPION, PREFIX, ModelVersion, read_version, read_versions, registered

FORMS = "ARCH, ARCH:RECIPE, NAME@ALIAS, NAME/VERSION or a models:/ URI"

_NOT_THERE = {"RESOURCE_DOES_NOT_EXIST", "INVALID_PARAMETER_VALUE"}


def resolve(reference: str) -> ModelVersion:
    """The version that a reference means, with all that is known about it.

    ``lstm2`` is the champion of prolearn-lstm2, ``lstm2:paper`` its newest version trained by
    that recipe, ``lstm2@ALIAS`` and ``lstm2/3`` one version; the registered name
    ``prolearn-lstm2`` serves as well as the architecture's, and ``models:/`` may stand before.

    Raises:
        InputError: where there is no such model; it lists what there is.
        ProlearnError: where the store fails.
    """
    with opened(create=False) as store:
        return find(store, reference)


def find(store: Store, reference: str) -> ModelVersion:
    """Same as :func:`resolve`, in an open store."""
    name, mark, rest = _parts(reference)
    try:
        found = _search(store, name, mark, rest)
    except MlflowException as error:
        if error.error_code not in _NOT_THERE:
            raise
        found = None
    if found is None:
        raise InputError(
            f"There is no model {reference!r} in the registry; expected {FORMS}, of which there "
            f"{_what_there_is(read_versions(store))}: train one with `prolearn train --arch ARCH "
            "--recipe RECIPE`."
        )
    return found


def _parts(reference: str) -> tuple[str, str, str]:
    """Name, the sign after it, and what follows; sign and rest are empty for a bare name."""
    match = re.fullmatch(
        r"(?:models:/+)?([A-Za-z0-9_.-]+)(?:([:/@])([A-Za-z0-9_.-]+))?", reference.strip()
    )
    if match is None:
        raise InputError(f"The model is given as {reference!r}; expected {FORMS}.")
    return match[1], match[2] or "", match[3] or ""


def _search(store: Store, name: str, mark: str, rest: str) -> ModelVersion | None:
    """The version, or None; MLflow raises where the alias or the number is unknown."""
    if name.startswith("m-") and not mark:
        return next((v for v in read_versions(store) if v.model_id == name), None)
    names = {m.name for m in registered(store)}
    known = next((n for n in (name, PREFIX + name) if n in names), None)
    if known is None:
        return None
    if mark == ":" or (mark, rest) == ("/", "latest"):
        recipe = rest if mark == ":" else None
        versions = [v for v in read_versions(store) if v.name == known]
        return next((v for v in reversed(versions) if recipe in (None, v.recipe)), None)
    if mark == "/":
        return read_version(store, store.client.get_model_version(known, rest))
    alias = rest or CHAMPION
    return read_version(store, store.client.get_model_version_by_alias(known, alias))


def _what_there_is(versions: list[ModelVersion]) -> str:
    if not versions:
        return "are none yet"
    return "are " + ", ".join(
        f"{v.name}/{v.version} ({', '.join((v.recipe, *v.aliases))})" for v in versions
    )
