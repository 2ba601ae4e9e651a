"""Registered networks as planners, in the experiments and for the command ``plan``."""

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
from pipeline.planners.named import refuse_effort, with_expert
from pipeline.planners.network import NetworkPlanner, check_problem
from pipeline.planners.planner import Planner
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
        """It as a planner, whose plans can be flown."""
        return NetworkPlanner(self.model, self.name)

    @property
    def evaluated(self) -> EvaluatedPlanner:
        """It flown and as predicted, for workers, who need not know of MLflow."""
        of = self.version
        return EvaluatedPlanner(self.planner, of.recipe, of.training_seed, self.model)

    def on(self, problem: Problem) -> "EvaluatedNetwork":
        """The same network for another time grid; InputError where its weights do not fit."""
        return replace(self, model=self.model.on(problem))


def newest_on(data: Where) -> list[ModelVersion]:
    """The newest trainings on a dataset; InputError where all models were trained on others."""
    manifest = read_manifest(data)
    found = newest_trainings({n: manifest.digest(n) for n in manifest.samples})
    if not found and (others := newest_trainings()):
        known = ", ".join(sorted({v.params.get("dataset", "unknown") for v in others}))
        raise InputError(
            f"no model was trained on {public_url(data)} as it is now; expected some: train one, "
            f"or name models with --models (there are some trained on {known})."
        )
    return found


def networks(
    references: Sequence[str], data: Where, arch: str = "", device: str | None = None
) -> list[EvaluatedNetwork]:
    """Networks by reference; without any, the newest trained on some data.

    The latter are of one architecture if given. Refiners plan on a torch device if given.
    InputError for a reference that is no model, a model of another orbit or time grid than the
    data's, or a device and no refiner.
    """
    named = {v.uri: v for v in map(resolve, references)}.values()
    chosen = named or [v for v in newest_on(data) if arch in ("", v.arch)]
    chosen = sorted(chosen, key=lambda v: (v.arch, v.recipe, v.training_seed, v.version))
    if device is not None and REFINER not in {version.arch for version in chosen}:
        raise InputError(
            f"device is {device} and no refiner is among the models, which alone plans there; "
            "expected one: train it or name it with --models, or leave --device out."
        )
    found, problem, names = [], read_manifest(data).problem, table_names(chosen)
    for version in chosen:
        model, _ = load(version)
        check_problem(model, problem, public_url(data))
        if version.arch == REFINER:
            model = replace(model, device=device)
        found.append(EvaluatedNetwork(model, version, names[version.uri]))
    return found


def classical_planners() -> list[EvaluatedPlanner]:
    """The expert in both separation settings, and the baselines."""
    at_nodes = Expert(name="expert (nodes only)", requirements=Requirements("nodes"))
    return [EvaluatedPlanner(planner) for planner in (Expert(), at_nodes, *BASELINES)]


def model_planner(
    reference: str, requirements: Requirements, *, effort: str | None, raw: bool
) -> Planner:
    """The planner of a registered model; InputError where there is none.

    The expert comes after it, as in ``with_expert``, unless ``raw``, which takes no effort.
    """
    if raw:
        refuse_effort(effort)
    model, version = load(reference)
    flown = NetworkPlanner(model, f"{version.arch}/{version.version}", requirements)
    return flown if raw else with_expert(flown, effort)
