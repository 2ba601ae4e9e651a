"""Errors whose messages say what was given, what is expected and what to do."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from math import isfinite
from numbers import Integral, Real
from reprlib import repr as brief
from sys import float_info
from typing import Any


class ProlearnError(Exception):
    """A run that failed for a reason outside the input; the command line exits with 1."""


class InputError(ProlearnError):
    """Input that cannot be worked with, in one sentence; the command line exits with 2."""


def is_number(value: object) -> bool:
    """Whether a value is a real number, of Python or numpy, but no boolean, and fits a float."""
    if type(value) is float:  # nearly all
        return True
    most = float_info.max
    if isinstance(value, int | Fraction) and not -most <= value <= most:
        return False
    return is_whole(value) or (isinstance(value, float | Real) and not isinstance(value, Integral))


def check_range(name: str, value: float | int, least: float | int, most: float | int) -> None:
    """Refuse a number out of range, or what is none, by an InputError that names the quantity."""
    if not is_number(value):
        raise InputError(f"{name} is {brief(value)}; expected a number from {least} to {most}.")
    if not least <= float(value) <= most:
        given, low, high = map(_short, (value, least, most))
        raise InputError(f"{name} is {given}; expected a number from {low} to {high}.")


def check_finite(name: str, value: float, unit: str) -> None:
    """Refuse what is no finite number by an InputError that names the quantity and its unit."""
    if not (is_number(value) and isfinite(value)):
        raise InputError(f"{name} is {brief(value)}; expected a finite number of {unit}.")


def is_whole(value: object) -> bool:
    """Whether a value is an integer, of Python or numpy; booleans and spans of time are not."""
    whole = isinstance(value, Integral) and hasattr(value, "__index__")  # as numpy's spans have not
    return whole and not isinstance(value, bool)


def check_whole(name: str, value: int, least: int, most: int) -> None:
    """Refuse an integer out of range, or what is none, by an InputError that names the quantity."""
    if not is_whole(value):
        low, high = map(_short, (least, most))
        raise InputError(f"{name} is {brief(value)}; expected a whole number from {low} to {high}.")
    check_range(name, value, least, most)


def check_vector(name: str, given: Sequence[float], size: int = 3) -> None:
    """Refuse what is no vector of finite numbers of some size by an InputError."""
    fine = isinstance(given, tuple | list) and len(given) == size
    if not fine or not all(is_number(one) and isfinite(one) for one in given):
        raise InputError(f"{name} is {given}; expected {size} finite numbers.")


def check_choice(name: str, value: object, choices: Iterable[str]) -> None:
    """Refuse a value that is none of the choices by an InputError that names the quantity."""
    known = list(choices)
    if not isinstance(value, str) or value not in known:
        raise InputError(f"{name} is {value!r}; expected {' or '.join(known)}.")


def check_kind(name: str, value: object, kind: Any) -> None:
    """Refuse what is no instance of a class, or of a union of classes, by an InputError."""
    if isinstance(value, type) or not isinstance(value, kind):  # a class passes for a protocol
        names = (one.__name__ for one in getattr(kind, "__args__", (kind,)))
        wanted = " or ".join(names).replace("NoneType", "None")
        raise InputError(f"{name} is {brief(value)}; expected {wanted}.")


def list_if_iterable(values: Any) -> Any:
    """The values of an iterable as a list; anything else, such as a scalar array, unchanged."""
    try:
        each = iter(values)
    except TypeError:
        return values
    return list(each)


def check_text(name: str, value: Any) -> None:
    """Raise InputError for a value that is not a string, or not valid Unicode."""
    check_kind(name, value, str)
    if any("\ud800" <= one <= "\udfff" for one in value):
        raise InputError(f"{name} is {value!a}; expected text without halves of characters.")


def check_each(name: str, values: object, kind: type) -> None:
    """Refuse what is no list or tuple of instances of a class by an InputError."""
    if not isinstance(values, list | tuple) or not all(isinstance(one, kind) for one in values):
        raise InputError(f"{name} is {brief(values)}; expected a list of {kind.__name__}.")


def _short(value: float | int) -> str:
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return text if len(text) < 20 else f"{text[:8]}... ({len(text)} digits)"


# Import names of the packages of each extra; ``learn`` has those of ``refiner`` as well
EXTRAS = {
    "refiner": ("safetensors",),
    "onnx": ("onnx", "onnxruntime", "onnxscript"),
    "tune": ("optuna",),
    "dask": ("dask", "distributed"),
    "learn": (
        *("filelock", "fsspec", "joblib", "markdown_it", "mlflow", "pandas", "pyarrow"),
        *("sqlalchemy", "tabulate", "threadpoolctl", "torch", "yaml"),
    ),
}


@contextmanager
def error_context(where: object) -> Iterator[None]:
    """Prefix InputErrors raised in the block with the file or field that they are about."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


@contextmanager
def missing_extra_hint() -> Iterator[None]:
    """In the block a missing package of an extra is an InputError that names the extra."""
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        extra = next((extra for extra, packages in EXTRAS.items() if package in packages), None)
        if extra is None:
            raise
        raise InputError(
            f"this needs {package}, which is not installed; expected the extra `{extra}`: "
            f"pip install 'prolearn[{extra}]'."
        ) from error
