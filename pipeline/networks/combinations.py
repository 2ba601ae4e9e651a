"""Which combinations of craft a network of fixed size is asked about."""

from functools import lru_cache
from itertools import combinations
from math import ceil, comb

import numpy as np
from jaxtyping import Int

from pipeline.arrays import Array

MOST = 100
"""The paper's limit on combinations an instance."""


@lru_cache(maxsize=64)
def combinations_of(n: int, size: int) -> Int[Array, "k size"]:
    """Distinct combinations of ``size`` of n craft, every craft in some; a function of both alone.

    All of them where there are at most MOST. Otherwise random permutations, cut into pieces of
    ``size`` with the last piece wrapping round, until there are MOST: so craft are in nearly
    equally many. More than MOST only where fewer could not hold every craft.

    Args:
        n: craft in the swarm, at least ``size``.
        size: craft in a combination.

    Returns:
        Indices of craft, ascending in each row; read-only.
    """
    if comb(n, size) <= MOST:
        chosen = _all_combinations(n, size)
    else:
        chosen = _random_combinations(n, size, max(MOST, ceil(n / size)))
    chosen.flags.writeable = False
    return chosen


def _all_combinations(n: int, size: int) -> Int[Array, "k size"]:
    return np.array(list(combinations(range(n), size)))


def _random_combinations(n: int, size: int, count: int) -> Int[Array, "k size"]:
    rng = np.random.default_rng([n, size])
    pieces = ceil(n / size)
    chosen: dict[tuple[int, ...], None] = {}  # a set that keeps the order
    while len(chosen) < count:
        # The first permutation's pieces are distinct, so all of them stay, and cover every craft.
        rows = np.resize(rng.permutation(n), (pieces, size))
        chosen.update(dict.fromkeys(tuple(row) for row in np.sort(rows, axis=1).tolist()))
    return np.array(list(chosen)[:count])
