"""Networks whose fuel is known to rise with the noise that is put on their answers."""

import torch
from short_transfer import PROBLEM

from pipeline.networks.architecture import find
from pipeline.networks.encoding import Encoding
from pipeline.networks.model import Model

SCALE = (100.0, 200.0, 50.0, 0.1, 0.2, 0.05)


def network(scale: float) -> Model:
    """A network that answers with the least-energy transfers, and noise of some size on top.

    Flown, noise of size 0 burns the least energy, and the more noise the more fuel.
    """
    encoding = Encoding(PROBLEM, 3, "minimum-energy", "offset", SCALE, SCALE)
    found = find("ff1")
    torch.manual_seed(0)
    made = found.network(found.config, encoding, 0.0)
    for parameter in made.parameters():
        parameter.data *= scale
    return Model("ff1", found.config, "tuned", encoding, made)
