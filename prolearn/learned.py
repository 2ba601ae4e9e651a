"""Datasets and registered models, which need the extra ``learn``."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.errors import (
    InputError,
    check_choice,
    check_each,
    check_kind,
    check_whole,
    list_if_iterable,
    missing_extra_hint,
)
from pipeline.scenario import SPLITS
from pipeline.scenario.scenario import MOST_CRAFT

if TYPE_CHECKING:
    import pyarrow as pa

    from pipeline.networks.model import Model
    from registry.models import ModelVersion


def read_dataset(
    where: str | Path, n: int, split: str | None = None, columns: Iterable[str] | None = None
) -> "pa.Table":
    """Rows of a solved dataset, a folder or a URL, by swarm size; docs/dataset.md has the columns.

    By default these are the rows of all splits, train, valid and test, with all columns.

    Raises:
        InputError: where there is no dataset, or it has no such rows.
    """
    with missing_extra_hint():
        from pipeline.dataset.reading import solved_rows, without_rows
        from pipeline.dataset.schema import SOLVED_FIELDS

    if split is not None:
        check_choice("split", split, SPLITS)
    check_whole("n", n, 1, MOST_CRAFT)
    if isinstance(columns, str):
        raise InputError(f"columns is {columns!r}; expected a list: give [{columns!r}].")
    wanted = None if columns is None else list_if_iterable(columns)
    if wanted is not None:
        check_each("columns", wanted, str)
    for column in wanted or ():
        check_choice("column", column, [field.name for field in SOLVED_FIELDS])
    rows = solved_rows(where, n, split, wanted)
    if len(rows) == 0:
        raise without_rows(where, f"rows of n={n} in its {split} split")
    return rows if wanted is None else rows.select(wanted)


def models() -> "list[ModelVersion]":
    """Every registered model version, by name and number, with its parameters and metrics."""
    with missing_extra_hint():
        from registry.models import list_versions

    return list_versions()


def load_model(reference: str) -> "tuple[Model, ModelVersion]":
    """A registered network and its version, such as lstm2, ff1:paper or prolearn-ff1/3.

    Raises:
        InputError: where there is no such model, or its files are not sound.
    """
    with missing_extra_hint():
        from registry.models import load

    check_kind("reference", reference, str)
    return load(reference)
