"""The array type that shapes are written on: ``States``, checked in tests."""

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    Array = npt.NDArray[Any]
    ArrayOrNumber = npt.NDArray[Any]
else:
    Array = np.ndarray
    ArrayOrNumber = np.ndarray | np.generic  # which numpy gives for an array of no dimension
