"""The paper's feed-forward networks FF1, FF2 and FFcol: dense layers on all states at once."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, pairwise
from math import ceil, comb
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field
from torch import nn

from pipeline.arrays import Array, Float, Int
from pipeline.documents import Strict
from pipeline.networks.encoding import Encoding, Trajectories
from pipeline.networks.supervised import Supervised

MAX_WIDTH = 1_000_000  # more neurons in a layer than this is a mistake


class Layers(Strict):
    """Configuration: units of each hidden layer, in order; ValueError for invalid ones."""

    hidden: list[Annotated[int, Field(ge=1, le=MAX_WIDTH, strict=True)]] = Field(
        min_length=1, max_length=100
    )


@dataclass(frozen=True)
class Layered(Supervised):
    """A network of hidden layers, which its configuration lists."""

    hidden: tuple[int, ...]  # units of each
    collision: bool = False  # whether the loss has the collision penalty

    @property
    def config(self) -> Mapping[str, Any]:
        """Units of each hidden layer."""
        return {"hidden": list(self.hidden)}


@dataclass(frozen=True)
class FeedForward(Layered):
    """Dense layers on the flattened 6·n·T matrix, each hidden one with ReLU and dropout.

    Its input has a fixed size. A smaller swarm is padded with virtual craft at rest at the origin;
    a larger one is answered with the average over combinations of its craft.
    """

    def network(self, config: Mapping[str, Any], encoding: Encoding, dropout: float) -> nn.Module:
        """Dense layers from 6·n·T numbers to 6·n·T numbers."""
        size = 6 * encoding.n * encoding.problem.nodes
        widths = [size, *Layers(**config).hidden]
        layers: list[nn.Module] = []
        for before, after in pairwise(widths):
            layers += [nn.Linear(before, after), nn.ReLU(), nn.Dropout(dropout)]
        return nn.Sequential(*layers, nn.Linear(widths[-1], size))

    def forward(self, network: nn.Module, inputs: Trajectories, encoding: Encoding) -> Trajectories:
        """The answer for n craft, padded or averaged where n is not that of the training."""
        n = inputs.shape[1]
        if n > encoding.n:
            return _average(network, inputs, encoding.n)
        padded = nn.functional.pad(inputs, (0, 0, 0, 0, 0, encoding.n - n))
        return _answer(network, padded)[:, :n]


def _answer(network: nn.Module, inputs: Trajectories) -> Trajectories:
    return network(inputs.flatten(1)).reshape(inputs.shape)  # of (b, 6nT)


def _average(network: nn.Module, inputs: Trajectories, size: int) -> Trajectories:
    """Each craft's mean answer over the combinations that it is in."""
    b, n, T, _ = inputs.shape
    chosen = combinations_of(n, size)  # (k, size)
    craft = torch.from_numpy(chosen.copy()).to(inputs.device)
    swarms = inputs[:, craft].reshape(-1, size, T, 6)  # (b·k, size, T, 6)
    answers = _answer(network, swarms).reshape(b, chosen.size, 6 * T)  # (b, k·size, 6T)
    # A product, not index_add: ONNX has no sum over repeated indices.
    shares = torch.from_numpy(_shares(n, size)).to(inputs)  # (n, k·size)
    return (shares @ answers).reshape(inputs.shape)


@lru_cache(maxsize=64)
def _shares(n: int, size: int) -> Float[Array, "n _"]:
    """Weights of each combination's answers in its craft's mean."""
    craft = combinations_of(n, size).flatten()
    member = np.arange(n)[:, None] == craft
    return member / member.sum(axis=1, keepdims=True)


MOST_COMBINATIONS = 100  # the paper's limit on combinations for each instance


@lru_cache(maxsize=64)
def combinations_of(n: int, size: int) -> Int[Array, "k size"]:
    """Distinct combinations of ``size`` of n craft, each craft in some; the same in every call.

    All of them where there are at most MOST_COMBINATIONS. Otherwise random permutations, cut into
    pieces of ``size`` with the last piece wrapping round, until there are so many: each craft is
    then in about equally many. There are more only where fewer cannot hold every craft. Indices
    ascend in each row, and are read-only.
    """
    if comb(n, size) <= MOST_COMBINATIONS:
        found = np.array(list(combinations(range(n), size)))
    else:
        rng, pieces = np.random.default_rng([n, size]), ceil(n / size)
        count = max(MOST_COMBINATIONS, pieces)
        chosen: dict[tuple[int, ...], None] = {}  # a set that keeps the order
        while len(chosen) < count:
            # The first permutation's pieces are distinct, so they stay, and cover every craft.
            rows = np.resize(rng.permutation(n), (pieces, size))
            chosen.update(dict.fromkeys(tuple(row) for row in np.sort(rows, axis=1).tolist()))
        found = np.array(list(chosen)[:count])
    found.flags.writeable = False
    return found


FF1 = FeedForward((180,))
FF2 = FeedForward((180, 150))
FFCOL = FeedForward((180,), collision=True)
