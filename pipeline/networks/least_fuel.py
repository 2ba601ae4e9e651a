"""Own optima by table for networks: ``pipeline.orbit.decoupled`` on tensors, batched.

Controls are linear in the change of state within a facet, so gradients run through them.
"""

from dataclasses import dataclass
from functools import lru_cache, partial

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.errors import InputError
from pipeline.orbit.decoupled import facets_of
from pipeline.orbit.problem import Problem

ROUNDING = 16
"""Share of the fuel by which a weight may be negative, in units of the type's precision."""


@dataclass(frozen=True, eq=False)
class Hull:
    """The tensors of ``pipeline.orbit.decoupled.Facets``."""

    component: Int[Tensor, "d"]
    column: Int[Tensor, "F d"]
    sign: Float[Tensor, "F d"]
    weights: Float[Tensor, "F d d"]
    dual: Float[Tensor, "F d"]


@dataclass(frozen=True, eq=False)
class LeastFuel:
    """Optima without a thrust limit, each craft on its own.

    Attributes:
        controls: m/s².
        bound: fuel that no controls go below, m/s².
        dual: y that proves it.
        basis: basic variables: the number of a control, flattened by time, or 3(T-1) more where
            it acts in the negative direction.
    """

    controls: Float[Tensor, "*batch intervals 3"]
    bound: Float[Tensor, "*batch"]
    dual: Float[Tensor, "*batch 6"]
    basis: Int[Tensor, "*batch 6"]


def least_fuel(miss: Float[Tensor, "*batch 6"], problem: Problem) -> LeastFuel:
    """Least-fuel controls for changes of the final state, m and m/s.

    Raises:
        InputError: for a problem whose controls do not reach every state.
    """
    rows, m = miss.reshape(-1, 6), 3 * problem.intervals
    flat, dual = rows.new_zeros(len(rows), m), torch.zeros_like(rows)
    bound, basis = rows.new_zeros(len(rows)), rows.new_zeros(rows.shape, dtype=torch.long)
    for hull in _hulls(problem, miss.dtype, miss.device):
        part = rows[:, hull.component]
        facet, weight = _met(hull, part)
        column, sign = hull.column[facet], hull.sign[facet]
        flat = flat.scatter(1, column, weight * sign)
        dual[:, hull.component] = hull.dual[facet]
        bound = bound + (part * hull.dual[facet]).sum(dim=1)
        basis[:, hull.component] = column + m * (sign < 0)
    batch = miss.shape[:-1]
    return LeastFuel(
        flat.reshape(*batch, -1, 3),
        bound.clamp(min=0).reshape(batch),
        dual.reshape(miss.shape),
        basis.reshape(miss.shape),
    )


def _met(hull: Hull, part: Float[Tensor, "N d"]) -> tuple[Int[Tensor, "N"], Float[Tensor, "N d"]]:
    """The facet that each ray meets, and the weights of its corners.

    Where several share a plane, that is the one whose weights are not negative.
    """
    value = part @ hull.dual.T
    facet = value.argmax(dim=1)
    weight = _weights(hull, facet, part)
    rounding = ROUNDING * torch.finfo(part.dtype).eps
    wrong = (weight.amin(dim=1) < -rounding * weight.abs().sum(dim=1)).nonzero()[:, 0]
    if len(wrong):
        every = torch.einsum("fij,nj->nfi", hull.weights, part[wrong]).amin(dim=2)
        best = value[wrong].amax(dim=1, keepdim=True)
        every[value[wrong] < best - rounding**0.5 * best.abs()] = -torch.inf
        facet = facet.index_copy(0, wrong, every.argmax(dim=1))
        weight = _weights(hull, facet, part)
    return facet, weight


def _weights(
    hull: Hull, facet: Int[Tensor, "N"], part: Float[Tensor, "N d"]
) -> Float[Tensor, "N d"]:
    return torch.einsum("nij,nj->ni", hull.weights[facet], part)


@lru_cache(maxsize=32)
@torch.inference_mode(mode=False)  # what is kept must serve training too
def _hulls(problem: Problem, dtype: torch.dtype, device: torch.device) -> tuple[Hull, ...]:
    table = facets_of(problem)
    if table is None:
        raise InputError(f"no controls reach every state of {problem}; expected another time grid.")
    place = partial(torch.as_tensor, device=device)
    real = partial(torch.as_tensor, dtype=dtype, device=device)
    return tuple(
        Hull(
            place(one.component),
            place(one.column),
            real(one.sign),
            real(one.weights),
            real(one.dual),
        )
        for one in table
    )
