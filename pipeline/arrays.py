"""The types of arrays that shapes are written on, checked in tests: ``Float[Array, "n T 6"]``."""

import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

__all__ = ["Array", "ArrayOrNumber", "Bool", "Float", "Float64", "Int", "Shaped"]

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
