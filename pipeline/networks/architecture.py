"""What an architecture is: sizes, forward pass, loss, and how it meets swarms of any size.

To add one, write one file and one entry point. The file holds an object with the members of
``Architecture``; ``pipeline/networks/lstm.py`` is the shortest example. The entry point names it:

    [project.entry-points."prolearn.architectures"]
    mine = "my_package.mine:MINE"

Then ``mine`` can be trained, saved, loaded, evaluated and planned with like the built-in ones.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor, nn

from pipeline.errors import InputError, ProlearnError
from pipeline.networks.catalogue import entry_point
from pipeline.networks.encoding import Encoding


@runtime_checkable
class Architecture(Protocol):
    """One way from encoded inputs to encoded trajectories.

    Tensors are float32, in the units of an ``Encoding``, with axes batch, craft, node and state
    component; ``Encoding.decode`` turns them into m and m/s. In every input the first and last
    node of each craft hold its initial and goal state.
    """

    @property
    def config(self) -> Mapping[str, Any]:
        """Sizes as plain JSON values; they are stored with each model."""
        ...

    @property
    def recipes(self) -> Mapping[str, Mapping[str, Any]]:
        """By recipe name, the fields of ``pipeline.training.recipes.Recipe`` that differ."""
        ...

    def network(self, config: Mapping[str, Any], encoding: Encoding, dropout: float) -> nn.Module:
        """An untrained module.

        It must be a function of its arguments alone, since a stored model is rebuilt with it:
        ``config`` comes from a file and may hold anything; raise ValueError where it makes no
        sense.

        Args:
            config: sizes, as in the property of this name.
            encoding: swarm size, nodes and problem that the network is for.
            dropout: share of each hidden layer's outputs to drop in training.
        """
        ...

    def loss(
        self,
        network: nn.Module,
        inputs: Float[Tensor, "b n T 6"],
        target: Float[Tensor, "b n T 6"],
        encoding: Encoding,
        collision_weight: float,
    ) -> Float[Tensor, ""]:
        """What training makes small: a mean over a batch with n = ``encoding.n``."""
        ...

    def forward(
        self, network: nn.Module, inputs: Float[Tensor, "b n T 6"], encoding: Encoding
    ) -> Float[Tensor, "b n T 6"]:
        """The network's answer for any number of craft n ≥ 1."""
        ...


@lru_cache
def find(name: str) -> Architecture:
    """The architecture of a name, looked up once.

    Raises:
        InputError: for an unknown name, or where the entry point leads to something else.
        ProlearnError: where its module cannot be imported.
    """
    point = entry_point(name)
    try:
        found = point.load()
    except (ImportError, AttributeError) as error:
        raise ProlearnError(
            f"architecture {name!r} cannot be loaded from {point.value} ({error}); install the "
            "distribution that declares it again."
        ) from error
    if not isinstance(found, Architecture):
        raise InputError(
            f"architecture {name!r} is {point.value}, which lacks members of "
            "pipeline.networks.architecture.Architecture; add them."
        )
    return found
