"""Array types for shape annotations, ``Float[Array, "n T 6"]``, and functions for numpy and torch.

Tests check the shapes. The functions let code run on both; they find torch already imported.
"""

import sys
from dataclasses import fields
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from pipeline.errors import check_kind

__all__ = ["Bool", "Float", "Float64", "Int", "Shaped"]  # of jaxtyping, for others to import here

if TYPE_CHECKING:
    Array = npt.NDArray[Any]
    ArrayOrNumber = npt.NDArray[Any]
else:
    Array = np.ndarray
    ArrayOrNumber = np.ndarray | np.generic  # which numpy gives for an array of no dimension

# Where shapes are checked jaxtyping is imported first. Elsewhere annotations are what it says to a
# type checker: its import would add some 0.05 s to every command.
if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Float, Float64, Int, Shaped
else:
    from typing import Annotated

    Bool = Float = Float64 = Int = Shaped = Annotated


def namespace(values: Any) -> Any:
    """Library of an array: numpy or torch."""
    return np if isinstance(values, np.ndarray) else sys.modules["torch"]


def fields_as_python(of: Any) -> None:
    """Convert a dataclass's fields to Python numbers and tuples, as files and hashes need them.

    InputError for a flag that is no boolean, or a name that is no text.
    """
    for field in fields(of):
        given = getattr(of, field.name)
        if (made := _as_python(given)) is not given:
            object.__setattr__(of, field.name, made)
        if field.type in (bool, str):
            check_kind(field.name, made, field.type)


def _as_python(given: Any) -> Any:
    if isinstance(given, np.ndarray | np.generic):
        given = given.tolist()
    if isinstance(given, list | tuple):
        return tuple(map(_as_python, given))
    return float(given) if isinstance(given, Real) and not isinstance(given, int) else given


def plain(values: Any) -> Shaped[Array, "..."]:
    """Contiguous numpy array of an array or tensor, detached from gradients, for compiled code."""
    if isinstance(values, np.ndarray):
        return np.ascontiguousarray(values)
    return values.detach().cpu().contiguous().numpy()


def tensor(values: Any, device: Any) -> Any:
    """Torch tensor of an array on a device; a tensor is returned as it is."""
    if not isinstance(values, np.ndarray):
        return values
    return sys.modules["torch"].from_numpy(np.require(values, requirements="W")).to(device)


def like(values: Any, other: Any) -> Any:
    """Array in the library of another, numpy or torch, and on its device; without its gradient."""
    if not isinstance(other, np.ndarray):
        return tensor(values, other.device)
    return plain(values) if hasattr(values, "detach") else values
