"""Who takes part in the experiments: expert, baselines and registered networks."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.evaluation.baselines import BASELINES, fuel_lower_bounds
from pipeline.evaluation.trials import Entrant
from pipeline.expert import Expert, Settings
from pipeline.networks.flown import Flown
from pipeline.networks.model import Model
from registry.models import load, newest_trainings
from registry.version import ModelVersion


@dataclass(frozen=True)
class Network:
    """A registered network that takes part.

    Attributes:
        model: the network.
        version: what the registry knows about it.
        name: what tables call it: its architecture, with the version where two would be alike
            in recipe and training seed too.
    """

    model: Model
    version: ModelVersion
    name: str

    @property
    def label(self) -> str:
        """Name and recipe; trainings that differ in their seed alone share it."""
        return f"{self.name} {self.version.recipe}"

    @property
    def entrant(self) -> Entrant:
        """The network flown, and as predicted."""
        flown = Flown(self.model, self.name, fuel_lower_bounds)
        return Entrant(flown, self.version.recipe, self.version.training_seed, self.model)


def networks(references: Sequence[str]) -> list[Network]:
    """The networks of some references; without any, the newest of each recipe and training seed.

    Raises:
        InputError: for a reference to nothing.
        ProlearnError: where the store fails.
    """
    chosen: Sequence[str | ModelVersion] = references or newest_trainings()
    found = {version.uri: (model, version) for model, version in map(load, chosen)}
    alike = Counter((v.label, v.training_seed) for _, v in found.values())
    return [
        Network(
            model, v, v.arch if alike[v.label, v.training_seed] == 1 else f"{v.arch}/{v.version}"
        )
        for model, v in found.values()
    ]


def unlearned() -> list[Entrant]:
    """The expert in both separation settings, and the baselines."""
    at_nodes = Expert(Settings(separation="nodes"), "expert (nodes only)")
    return [Entrant(planner) for planner in (Expert(), at_nodes, *BASELINES)]
