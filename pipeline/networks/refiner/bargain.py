"""What is learned: how two craft that meet share the way that they must give.

Each encounter has two sides, one for either craft, with the same numbers seen from each. All that
a side reads is its own craft's or was told by the other one; what a craft's sides tell each other
is summed. So no number of a craft means anything: renumbered craft agree on the same.
"""

from collections.abc import Collection
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.networks.refiner.ablations import PARTS, Part
from pipeline.networks.refiner.sides import Sides

FEATURES = 18
"""Numbers that a side sees, before what it remembers."""

MARGIN = 0.2 / 15
"""Usual separation beyond r_col that is asked for, in r_col."""

STEEP = 4.0
"""Steepness of shares, so that weights of order 1 can give the whole way to one craft."""

MOST_TRADE = 0.3
"""Most that a craft gives way beyond its share, r_col."""

MOST_TILT = 0.5
"""Most that a plane is tilted in either direction, as a tangent."""


@dataclass(frozen=True, eq=False)
class Terms:
    """What the sides of L encounters agree on.

    Attributes:
        share: added to the logit of the first craft's share, (L,).
        trade: what the first craft gives way beyond its share, and the second less, r_col, (L,).
        margin: separation asked for beyond r_col, in r_col, (L,).
        tilt: of the plane's normal along the motion and across it, as tangents, (L, 2).
        memory: what each side remembers, (L, 2, H).
    """

    share: Float[Tensor, "L"]
    trade: Float[Tensor, "L"]
    margin: Float[Tensor, "L"]
    tilt: Float[Tensor, "L 2"]
    memory: Float[Tensor, "L 2 H"]


class Bargain(nn.Module):
    """Messages between the sides of encounters, and what they agree on.

    Untrained it adds nothing to the rule that the rounds go by without it.

    Attributes:
        memory: numbers that a side remembers.
        rounds: that an answer takes.
        uses: 1 for each part that it has and 0 for those left out, stored with the weights.
    """

    uses: Float[Tensor, "_"]

    def __init__(self, width: int, memory: int, rounds: int) -> None:
        """Sizes of hidden layers and memory, and the rounds that an answer takes."""
        super().__init__()
        self.memory, self.rounds = memory, rounds
        self.read = _two_layers(2 * FEATURES + 2 * memory, width, memory)
        self.weigh = _two_layers(5 * memory, width, memory)
        self.tell = nn.Linear(memory, memory)
        self.agree = nn.Linear(2 * memory, 5)
        nn.init.zeros_(self.agree.weight)
        nn.init.zeros_(self.agree.bias)
        self.register_buffer("uses", torch.ones(len(PARTS)))

    def leave_out(self, parts: Collection[Part]) -> None:
        """Do without some parts from now on, and with all others."""
        self.uses.copy_(torch.tensor([float(part not in parts) for part in PARTS]))

    def forward(
        self,
        seen: Float[Tensor, "L 2 F"],
        memory: Float[Tensor, "L 2 H"],
        sides: Sides,
        likeness: Float[Tensor, "C p p"],
    ) -> Terms:
        """The terms of L encounters.

        Args:
            seen: what each side sees.
            memory: what it remembers.
            sides: which craft they are of.
            likeness: cosines between the planes of each craft.
        """
        *_, third, remembered = self.uses.unbind()
        memory = remembered * memory
        said = self.read(_with_other(torch.cat([seen, memory], dim=2)))  # (L, 2, H)
        told = sides.table(self.tell(said))  # (C, p, H)
        alike, every = sides.back(likeness @ told), sides.each(told.sum(dim=1))
        heard = third * torch.cat([alike, every], dim=2)
        return self.agreed(memory + self.weigh(torch.cat([said, _with_other(heard)], dim=2)))

    def agreed(self, memory: Float[Tensor, "L 2 H"]) -> Terms:
        """The terms that follow from what both sides of L encounters remember."""
        share, trade, margin, tilt, *_ = self.uses.unbind()
        used = torch.stack([share, trade, margin, tilt, tilt])
        one, other = (used * self.agree(_with_other(memory))).unbind(dim=1)  # (L, 5)
        odd, even = one - other, one + other
        return Terms(
            share=STEEP * odd[:, 0],
            trade=MOST_TRADE * torch.tanh(odd[:, 1]),
            margin=MARGIN * torch.exp(1.5 * torch.tanh(even[:, 2])),
            # Seen from the other side normal and motion are reversed, but not what is across.
            tilt=MOST_TILT * torch.tanh(torch.stack([even[:, 3], odd[:, 4]], dim=1)),
            memory=memory,
        )


def _two_layers(before: int, width: int, after: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(before, width), nn.SiLU(), nn.Linear(width, after))


def _with_other(values: Float[Tensor, "L 2 D"]) -> Float[Tensor, "L 2 _"]:
    """What a side has, and what the other side has."""
    return torch.cat([values, values.flip(1)], dim=2)
