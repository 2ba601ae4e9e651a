"""What is learned: by how much one of two craft that meet gives way more than its share.

Each encounter has two sides, one for either craft, with the same numbers seen from each. All that
a side reads is its own craft's or was told by the other one; what a craft's sides tell each other
is summed. So no number of a craft means anything: renumbered craft agree on the same.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.networks.refiner.hearsay import heard
from pipeline.networks.refiner.seen import FEATURES
from pipeline.networks.refiner.sides import Sides

MOST_TRADE = 0.3
"""Most that a craft gives way beyond its share, r_col."""


class Bargain(nn.Module):
    """Messages between the sides of encounters, and the trade that they agree on.

    Untrained it adds nothing to the rule that the rounds go by without it.

    Attributes:
        message: numbers in a message.
        rounds: that an answer takes.
        hears: 1 where sides hear of the other sides of both craft and 0 where not, stored with the
            weights.
    """

    hears: Float[Tensor, ""]

    def __init__(self, width: int, message: int, rounds: int) -> None:
        """Sizes of hidden layers and messages, and the rounds that an answer takes."""
        super().__init__()
        self.message, self.rounds = message, rounds
        self.read = _two_layers(2 * FEATURES, width, message)
        self.weigh = _two_layers(5 * message, width, message)
        self.tell = nn.Linear(message, message)
        self.offer = nn.Linear(message, 1, bias=False)
        nn.init.zeros_(self.offer.weight)
        self.register_buffer("hears", torch.ones(()))

    def forward(
        self, seen: Float[Tensor, "L 2 F"], sides: Sides, free: Float[Tensor, "L m"]
    ) -> Float[Tensor, "L"]:
        """The trades of L encounters, r_col.

        Args:
            seen: what each side sees.
            sides: which craft they are of.
            free: unit vectors by which the planes of a craft are alike.
        """
        said = self.read(torch.cat([seen, seen.flip(1)], dim=2))  # (L, 2, H)
        others = self.hears * heard(self.tell(said), free, sides)  # (L, 2, 2H)
        one, other = self.offers(said, others, others.flip(1)).unbind(dim=1)
        return trade_of(one, other)

    def offers(
        self,
        said: Float[Tensor, "*sides H"],
        heard: Float[Tensor, "*sides _"],
        told: Float[Tensor, "*sides _"],
    ) -> Float[Tensor, "*sides"]:
        """What each side offers, from what was said of it, it has heard, and the other has."""
        return self.offer(self.weigh(torch.cat([said, heard, told], dim=-1)))[..., 0]


def trade_of(offer: Float[Tensor, "L"], other: Float[Tensor, "L"]) -> Float[Tensor, "L"]:
    """What a craft that offers more than the other gives way beyond its share, r_col."""
    return MOST_TRADE * torch.tanh(offer - other)


def _two_layers(before: int, width: int, after: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(before, width), nn.SiLU(), nn.Linear(width, after))
