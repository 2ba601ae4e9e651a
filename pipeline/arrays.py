"""The array type that shapes are written on: ``Float[Array, "n T 6"]``, checked in tests."""

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    Array = npt.NDArray[Any]
else:
    Array = np.ndarray
