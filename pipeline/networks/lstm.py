"""The paper's recurrent networks LSTM1, LSTM2 and LSTMcol: a sequence of nT columns."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

from torch import Tensor, nn

from pipeline.arrays import Float
from pipeline.networks.encoding import Encoding, Trajectories
from pipeline.networks.feedforward import Layered, Layers

# Weights shared by all columns see nT times as many examples: fewer, larger steps suffice.
CHANGES: Mapping[str, Any] = {"learning_rate": 5e-3, "batch_size": 32, "epochs": 30}


class LstmLayers(nn.Module):
    """LSTM layers over the columns of the 6 x nT matrix, each followed by dropout."""

    def __init__(self, hidden: list[int], dropout: float) -> None:
        super().__init__()
        widths = [6, *hidden]
        self.layers = nn.ModuleList(
            nn.LSTM(before, after, batch_first=True) for before, after in pairwise(widths)
        )
        self.dropout = nn.Dropout(dropout)
        self.head = nn.Linear(widths[-1], 6)

    def forward(self, columns: Float[Tensor, "b nT 6"]) -> Float[Tensor, "b nT 6"]:
        """Six numbers for each column, from it and those before it."""
        hidden = columns
        for layer in self.layers:
            hidden, _ = layer(hidden)  # (b, nT, width)
            hidden = self.dropout(hidden)
        return self.head(hidden)


@dataclass(frozen=True)
class Lstm(Layered):
    """LSTM layers over the trajectories of all craft in sequence, which may be any number."""

    recipes: ClassVar[Mapping[str, Mapping[str, Any]]] = {"paper": CHANGES, "tuned": CHANGES}

    def network(self, config: Mapping[str, Any], encoding: Encoding, dropout: float) -> nn.Module:
        """LSTM layers and a linear layer back to six numbers a column."""
        return LstmLayers(Layers(**config).hidden, dropout)

    def forward(self, network: nn.Module, inputs: Trajectories, encoding: Encoding) -> Trajectories:
        """The answer for n craft: a sequence of nT columns, whatever n is."""
        return network(inputs.flatten(1, 2)).reshape(inputs.shape)  # of (b, nT, 6)


LSTM1 = Lstm((180,))
LSTM2 = Lstm((180, 150))
LSTMCOL = Lstm((180,), collision=True)
