"""The own optimum of one craft and its tableau, looked up without a branch: it can be traced.

``pipeline.networks.least_fuel`` for N = 1. The weights of the facet that is met are B⁻¹ but for
units, so the tableau needs no equations to be solved.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.errors import InputError
from pipeline.networks.least_fuel import ROUNDING
from pipeline.networks.refiner.grid import Grid
from pipeline.networks.refiner.pivots import SMALL
from pipeline.networks.refiner.program import Own
from pipeline.orbit.decoupled import Facets, facets_of
from pipeline.orbit.problem import Problem


def own_optimum(
    initial: Float[Tensor, "1 6"], goal: Float[Tensor, "1 6"], grid: Grid, problem: Problem
) -> Own:
    """The own optimum in r_col and Δt, N = 1.

    Raises:
        InputError: for a problem whose controls do not reach every state.
    """
    table = facets_of(problem)
    if table is None:
        raise InputError(f"no controls reach every state of {problem}; expected another time grid.")
    units = torch.tensor([1.0, 1 / grid.step], dtype=initial.dtype).repeat_interleave(3)
    miss = ((goal - initial @ grid.drift[-6:].T)[0] * units).to(initial.dtype)
    m, m_free = grid.reach.shape[1], grid.reach.shape[1] - 6
    inverse, side = miss.new_zeros(6, 6), torch.zeros_like(miss)
    basis = torch.zeros(6, dtype=torch.long)
    for facets in table:
        component = torch.from_numpy(facets.component)
        facet, weights = _met(facets, miss[component])
        its_side = torch.from_numpy(facets.sign)[facet][0]
        part = miss.new_zeros(len(component), 6).index_copy(1, component, weights)
        inverse = inverse.index_copy(0, component, its_side[:, None] * part)
        basis = basis.index_copy(0, component, torch.from_numpy(facets.column)[facet][0])
        side = side.index_copy(0, component, its_side)
    inverse = inverse * grid.step**2
    every = torch.arange(m)
    others = (every + m * torch.zeros(m, dtype=torch.long).scatter(0, basis, 1)).sort().values
    others = others[:m_free]
    tableau = (inverse * units) @ grid.to_goal[:, others]
    controls = miss.new_zeros(m).scatter(0, basis, inverse @ miss)
    record = (controls, basis, others, side, tableau, side @ tableau)
    return Own(*(part[None] for part in record))


def price_of_first(own: Own, gain: Float[Tensor, "P m"]) -> Float[Tensor, "P"]:
    """What the first unit along each row costs the craft: ``pivots.first_prices``."""
    moved = gain[:, own.others[0]] - gain[:, own.basis[0]] @ own.tableau[0]
    rise = torch.where(moved > 0, 1 - own.cost, 1 + own.cost)
    rise = torch.where(moved.abs() < SMALL, 1.0, rise)  # the sign of rounding says nothing
    return (rise / moved.abs().clamp(min=SMALL)).amin(dim=1)


def _met(facets: Facets, part: Float[Tensor, "d"]) -> tuple[Tensor, Float[Tensor, "d d"]]:
    """The facet that the ray meets, (1,), and its weights; ``least_fuel`` says which it is."""
    table, dual = torch.from_numpy(facets.weights), torch.from_numpy(facets.dual)
    value, weight = dual @ part, table @ part  # (F,), (F, d)
    first = value.argmax(dim=0, keepdim=True)
    rounding = ROUNDING * torch.finfo(part.dtype).eps
    best = value[first]
    near = value >= best - rounding**0.5 * best.abs()
    inner = torch.where(near, weight.amin(dim=1), -torch.inf).argmax(dim=0, keepdim=True)
    wrong = weight[first].min() < -rounding * weight[first].abs().sum()
    facet = torch.where(wrong, inner, first)
    return facet, table[facet][0]
