"""Array types for shape annotations, ``Float[Array, "n T 6"]``, and functions of arrays.

Tests check the shapes. The functions run on arrays and tensors; torch is never imported here.
"""

import ctypes
import hashlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from pipeline.errors import ProlearnError, check_kind, check_text, is_number

__all__ = ["Bool", "Float", "Float64", "Int", "Shaped"]  # jaxtyping's, re-exported

if TYPE_CHECKING:
    Array = npt.NDArray[Any]
    ArrayOrNumber = npt.NDArray[Any]
else:
    Array = np.ndarray
    ArrayOrNumber = np.ndarray | np.generic  # which numpy gives for an array of no dimension

# The tests, which check shapes, import jaxtyping first. Elsewhere it is not imported, which would
# add some 0.05 s to every command.
if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Float, Float64, Int, Shaped
else:
    from typing import Annotated

    Bool = Float = Float64 = Int = Shaped = Annotated


def namespace(values: Any) -> Any:
    """The library of an array: the numpy or the torch module."""
    return np if isinstance(values, np.ndarray) else sys.modules["torch"]


PLAIN = (float, int, bool, str, type(None))  # types of values that need no conversion


def fields_as_python(of: Any) -> None:
    """Convert a dataclass's fields to Python numbers and tuples, as files and hashes need them.

    InputError where a boolean or text field has a value of another type, or text is not Unicode.
    """
    for field in fields(of):
        given = getattr(of, field.name)
        if (made := _as_python(given)) is not given:
            object.__setattr__(of, field.name, made)
        if field.type is bool:
            check_kind(field.name, made, bool)
        if field.type is str:
            check_text(field.name, made)


def _as_python(given: Any) -> Any:
    if type(given) in PLAIN:  # nearly all
        return given
    given = as_lists(given)
    if isinstance(given, list | tuple):
        return tuple(map(_as_python, given))
    return float(given) if is_number(given) and not isinstance(given, int) else given


def as_floats(given: Any) -> Float[Array, "..."]:
    """An array of numbers as floats, NaN where masked; TypeError or ValueError if it is none."""
    found = np.asanyarray(given)
    numbers = found.dtype.kind in "iuf"
    if not numbers and not (found.dtype.kind == "O" and all(map(is_number, found.flat))):
        raise TypeError(f"they are {found.dtype.name}")
    return np.asarray(np.ma.filled(found.astype(float, copy=False), np.nan))


def as_lists(given: Any) -> Any:
    """An array or table of any library as lists and numbers; a time, or anything else, as it is."""
    if isinstance(given, type):
        return given
    if not hasattr(given, "tolist") and hasattr(given, "__array__"):  # such as a DataFrame
        given = np.asarray(given)
    is_time = isinstance(given, np.ndarray | np.generic) and given.dtype.kind in "mM"
    return given.tolist() if hasattr(given, "tolist") and not is_time else given


def plain(values: Any) -> Shaped[Array, "..."]:
    """Convert an array or tensor to a contiguous numpy array, for compiled code."""
    if isinstance(values, np.ndarray):
        return np.ascontiguousarray(values)
    return values.detach().cpu().contiguous().numpy()


def tensor(values: Any, device: Any) -> Any:
    """Convert an array to a torch tensor on a device; a tensor is returned as it is."""
    if not isinstance(values, np.ndarray):
        return values
    return sys.modules["torch"].from_numpy(np.require(values, requirements="W")).to(device)


def like(values: Any, other: Any) -> Any:
    """Convert values to the library, numpy or torch, and the device of another array."""
    if not isinstance(other, np.ndarray):
        return tensor(values, other.device)
    return plain(values) if hasattr(values, "detach") else values


# Of a compiled function's arguments, by letters: the data types of arrays, and other types
_DTYPES = {"d": np.float64, "q": np.int64, "b": np.bool_}
_TYPES = {"i": ctypes.c_int64, "r": ctypes.c_double}


@dataclass(frozen=True, eq=False)
class CompiledLibrary:
    """Functions of arrays in C, which an installation compiles (``setup.py``).

    Attributes:
        source: the C file, beside which the library is.
        functions: the types of each function's arguments, by a letter each: for arrays d, float64,
            q, int64, and b, boolean; i, a whole number; r, a real one; p, a pointer.
    """

    source: Path
    functions: Mapping[str, str]

    def call(self, name: str, *given: Any) -> int:
        """What a function returns. Arrays of results must be contiguous; None is no array.

        ProlearnError where the library is missing or was compiled of an earlier source.
        """
        function, dtypes = self._loaded[name]
        arrays = [
            one if dtype is None or one is None else np.ascontiguousarray(one, dtype)
            for one, dtype in zip(given, dtypes, strict=True)
        ]  # which must live during the call
        return function(
            *[one.ctypes.data if isinstance(one, np.ndarray) else one for one in arrays]
        )

    @cached_property
    def _loaded(self) -> Mapping[str, tuple[Any, list[Any]]]:
        """Each function, and the data types of its arguments."""
        path = self.source.with_name(f"lib{self.source.stem}.so")
        try:
            library = ctypes.CDLL(str(path))
            library.source.restype = ctypes.c_char_p
            made = library.source().decode()
        except (OSError, AttributeError):
            made = ""
        if made != hashlib.sha256(self.source.read_bytes()).hexdigest():
            raise ProlearnError(
                f"{path} is missing, for another machine or of an earlier {self.source.name}; "
                "expected what an installation compiles: install prolearn again by pip install."
            )
        loaded = {}
        for name, kinds in self.functions.items():
            function = getattr(library, name)
            function.argtypes = [_TYPES.get(kind, ctypes.c_void_p) for kind in kinds]
            function.restype = ctypes.c_int64
            loaded[name] = function, [_DTYPES.get(kind) for kind in kinds]
        return loaded
