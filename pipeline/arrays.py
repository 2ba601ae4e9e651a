"""The types of arrays that shapes are written on, checked in tests: ``Float[Array, "n T 6"]``."""

import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    Array = npt.NDArray[Any]
    ArrayOrNumber = npt.NDArray[Any]
else:
    Array = np.ndarray
    ArrayOrNumber = np.ndarray | np.generic  # which numpy gives for an array of no dimension

# Where shapes are checked jaxtyping is imported first. Elsewhere annotations are what it says to a
# type checker, since to import it takes a fifth of a command's time.
if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool as Bool
    from jaxtyping import Float as Float
    from jaxtyping import Float64 as Float64
    from jaxtyping import Int as Int
    from jaxtyping import Shaped as Shaped
else:
    from typing import Annotated

    Bool = Float = Float64 = Int = Shaped = Annotated
