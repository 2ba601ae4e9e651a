"""Who takes part in the experiments: expert, baselines and registered networks."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pipeline.dataset.manifest import read_manifest
from pipeline.errors import InputError
from pipeline.experiments.trials import EvaluatedPlanner
from pipeline.networks.model import Model
from pipeline.networks.recipes import for_comparison
from pipeline.plan import Requirements
from pipeline.planners.classical import BASELINES, Expert
from pipeline.planners.network import NetworkPlanner, check_problem
from pipeline.storage.folder import Where
from pipeline.urls import public_url
from registry.models import load, newest_trainings, resolve
from registry.version import ModelVersion


@dataclass(frozen=True)
class Network:
    """A registered network that takes part.

    Attributes:
        model: the network.
        version: what the registry knows about it.
        name: what tables call it: its architecture, with the version where trainings of one
            recipe differ in more than their seed.
    """

    model: Model
    version: ModelVersion
    name: str

    @property
    def label(self) -> str:
        """Name and recipe; trainings that differ in their seed alone share it."""
        return f"{self.name} {self.version.recipe}"

    @property
    def entrant(self) -> EvaluatedPlanner:
        """The network flown, and as predicted."""
        flown = NetworkPlanner(self.model, self.name)
        return EvaluatedPlanner(flown, self.version.recipe, self.version.training_seed, self.model)


Choice = Callable[[Where], list[ModelVersion]]
"""Which models take part where none is named, by the dataset."""


def planners_on(data: Where) -> list[ModelVersion]:
    """The newest trainings on a dataset, without those that only ablations are about.

    Raises:
        InputError: as for ``newest_on``.
    """
    return [v for v in newest_on(data) if not for_comparison(v.arch, v.recipe)]


def networks(references: Sequence[str], data: Where, choice: Choice = planners_on) -> list[Network]:
    """The networks of some references; without any, the newest that were trained on some data.

    They are in the same order whatever that of the references is.

    Args:
        references: models; none means the newest trainings of each architecture and recipe.
        data: the dataset that they are to be tried on.
        choice: which of these.

    Raises:
        InputError: for a reference to nothing, a model of another orbit or time grid than the
            data's, or where there are models and none was trained on this data.
        ProlearnError: where the store fails.
    """
    named = {v.uri: v for v in map(resolve, references)}.values()
    chosen = sorted(named or choice(data), key=_place)
    found, problem = _named(chosen), read_manifest(data).problem
    for network in found:
        check_problem(network.model, problem, public_url(data))
    return found


def _place(version: ModelVersion) -> tuple[str, str, int, int]:
    """Where a version stands among others: as in ``newest_trainings``."""
    return version.arch, version.recipe, version.training_seed, version.version


def newest_on(data: Where) -> list[ModelVersion]:
    """The newest trainings on a dataset.

    Raises:
        InputError: where there are models and none was trained on this data.
        ProlearnError: where the store fails.
    """
    manifest = read_manifest(data)
    found = newest_trainings({n: manifest.digest(n) for n in manifest.samples})
    if not found and (others := newest_trainings()):
        known = ", ".join(sorted({v.params.get("dataset", "unknown") for v in others}))
        raise InputError(
            f"no model was trained on {public_url(data)} as it is now; expected some: train one, "
            f"or name models with --models (there are some trained on {known})."
        )
    return found


def _named(versions: Sequence[ModelVersion]) -> list[Network]:
    """Networks by their architecture, and by version where that would average what differs.

    That is so where a recipe's trainings differ in more than their seed, or not even in that.
    """
    ways: dict[str, set[tuple[str, ...]]] = {}
    for version in versions:
        ways.setdefault(version.label, set()).add(version.way)
    alike = Counter((v.label, v.training_seed) for v in versions)

    def name(version: ModelVersion) -> str:
        alone = len(ways[version.label]) == alike[version.label, version.training_seed] == 1
        return version.arch if alone else f"{version.arch}/{version.version}"

    return [Network(load(version)[0], version, name(version)) for version in versions]


def unlearned() -> list[EvaluatedPlanner]:
    """The expert in both separation settings, and the baselines."""
    at_nodes = Expert(name="expert (nodes only)", requirements=Requirements("nodes"))
    return [EvaluatedPlanner(planner) for planner in (Expert(), at_nodes, *BASELINES)]
