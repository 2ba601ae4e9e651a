"""Functions of the refiner for numpy and torch alike, and its compiled loops (``kernels.c``)."""

import sys
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.arrays import Array, Bool, CompiledLibrary, Float, Int, Shaped, like, namespace, plain


def constant(values: Any) -> Any:
    """The same values, detached from gradients."""
    return values if isinstance(values, np.ndarray) else values.detach()


def cast(values: Any, other: Any) -> Any:
    """The same values in the data type of another array of the same module."""
    is_numpy = isinstance(values, np.ndarray)
    return values.astype(other.dtype, copy=False) if is_numpy else values.to(other.dtype)


def rows(values: Shaped[Any, "k *rest"], index: Int[Any, "j"]) -> Shaped[Any, "j *rest"]:
    """Some rows; for tensors by index_select, whose gradient is fast."""
    if isinstance(values, np.ndarray):
        return values[index]
    return values.index_select(0, like(index, values))


def with_rows(
    values: Shaped[Any, "k *rest"], index: Int[Any, "j"], new: Shaped[Any, "j *rest"]
) -> Shaped[Any, "k *rest"]:
    """A copy of the array with some rows replaced."""
    if not isinstance(values, np.ndarray):
        return values.index_copy(0, like(index, values), new)
    changed = values.copy()
    changed[index] = new
    return changed


def where(mask: Bool[Any, "*k"], other: Callable[[], Any], values: Any) -> Any:
    """Other values where a mask is true, computed only if it is somewhere, or in a traced graph."""
    xp = namespace(mask)
    if (xp is np or not xp.compiler.is_exporting()) and not mask.any():
        return values
    return xp.where(mask, other(), values)


def sigmoid(values: Float[Any, "*k"]) -> Float[Any, "*k"]:
    """1 / (1 + exp(-x)); numpy's own is fast and does not overflow."""
    return 0.5 * np.tanh(0.5 * values) + 0.5 if isinstance(values, np.ndarray) else values.sigmoid()


def self_adjoint(apply: Callable[[Array], Array], values: Any) -> Any:
    """Apply a compiled self-adjoint linear map, which maps gradients backward too."""
    is_numpy = isinstance(values, np.ndarray)
    return apply(values) if is_numpy else _self_adjoint()(values, apply)


@lru_cache(maxsize=1)
def _self_adjoint() -> Any:
    """The torch autograd function, whose class is made once torch is imported."""

    class SelfAdjoint(sys.modules["torch"].autograd.Function):  # type: ignore[misc]
        @staticmethod
        def forward(ctx: Any, values: Any, apply: Callable[[Array], Array]) -> Any:
            ctx.linear = apply
            return like(apply(plain(values)), values)

        @staticmethod
        def backward(ctx: Any, gradient: Any) -> tuple[Any, None]:
            return like(ctx.linear(plain(gradient)), gradient), None

    return SelfAdjoint.apply


KERNELS = CompiledLibrary(
    Path(__file__).with_name("kernels.c"),
    {
        "nearest": "iidqqqdbddb",
        "close_pairs": "iiiddiq",
        "add_up": "iiiddqqd",
        "solve_all": "iiirddqqddqqqddidqddd",
        "first_ratios": "iidqqdqddd",
    },
)
