"""Tensors as arrays for compiled code, which runs on the CPU."""

from jaxtyping import Shaped
from torch import Tensor

from pipeline.arrays import Array


def numbers(values: Tensor) -> Shaped[Array, "..."]:
    """The same numbers, without gradients and one after the other."""
    return values.detach().cpu().contiguous().numpy()
