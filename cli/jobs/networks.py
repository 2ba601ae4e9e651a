"""The planners of the experiments: registered networks, experts and baselines."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pipeline.dataset.manifest import read_manifest
from pipeline.errors import InputError
from pipeline.experiments.trials import EvaluatedPlanner
from pipeline.networks.model import Model
from pipeline.networks.recipes import REFINER
from pipeline.orbit.problem import Problem
from pipeline.plan import Requirements
from pipeline.planners.classical import BASELINES, Expert
from pipeline.planners.network import NetworkPlanner, check_problem
from pipeline.storage.folder import Where
from pipeline.text import public_url
from registry.models import ModelVersion, load, newest_trainings, resolve, table_names


@dataclass(frozen=True, eq=False)
class EvaluatedNetwork:
    """A registered network in the experiments, named by version too where trainings differ."""

    model: Model
    version: ModelVersion
    name: str

    @property
    def planner(self) -> NetworkPlanner:
        """The network as a planner, whose plans can be flown."""
        return NetworkPlanner(self.model, self.name)

    @property
    def evaluated(self) -> EvaluatedPlanner:
        """The network flown and as predicted, for workers, which need no MLflow."""
        version = self.version
        return EvaluatedPlanner(self.planner, version.recipe, version.training_seed, self.model)

    def on(self, problem: Problem) -> "EvaluatedNetwork":
        """The same network for another time grid; InputError where its weights do not fit."""
        return replace(self, model=self.model.on(problem))


def networks(
    references: Sequence[str], data: Where, arch: str = "", device: str | None = None
) -> list[EvaluatedNetwork]:
    """Networks by reference, or the newest trained on some data, of one architecture if given.

    Refiners plan on a torch device if given. InputError for a reference that is no model, a model
    of another orbit or time grid than the data's, or a device and no refiner.
    """
    manifest = read_manifest(data)
    chosen = [*{v.uri: v for v in map(resolve, references)}.values()]
    if not chosen:
        newest = newest_trainings({n: manifest.digest(n) for n in manifest.samples})
        if not newest and (others := newest_trainings()):
            known = ", ".join(sorted({v.params.get("dataset", "unknown") for v in others}))
            raise InputError(
                f"no model was trained on {public_url(data)} as it is now; expected some: train "
                f"one, or name models with --models (there are some trained on {known})."
            )
        chosen = [v for v in newest if arch in ("", v.arch)]
    chosen.sort(key=lambda v: (v.arch, v.recipe, v.training_seed, v.version))
    if device is not None and REFINER not in {version.arch for version in chosen}:
        raise InputError(
            f"device is {device} and no refiner is among the models, which alone plans there; "
            "expected one: train it or name it with --models, or leave --device out."
        )
    found, names = [], table_names(chosen)
    for version in chosen:
        model, _ = load(version)
        check_problem(model, manifest.problem, public_url(data))
        if version.arch == REFINER:
            model = replace(model, device=device)
        found.append(EvaluatedNetwork(model, version, names[version.uri]))
    return found


def classical_planners() -> list[EvaluatedPlanner]:
    """The expert in both separation settings, and the baselines."""
    at_nodes = Expert(name="expert (nodes only)", requirements=Requirements("nodes"))
    return [EvaluatedPlanner(planner) for planner in (Expert(), at_nodes, *BASELINES)]
