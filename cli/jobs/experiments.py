"""Experiments 1 to 5 on the test split of a dataset, recorded for the report and MLflow's UI."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from cli.jobs.run_tables import add_to_model
from cli.options import int_list, name_list, numbers
from cli.settings import Evaluation, ExperimentSettings, Flights, TransferTimes, WarmStarts
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.reading import solved_scenarios, without_rows
from pipeline.errors import InputError, check_choice, check_whole
from pipeline.experiments.example_transfer import example_transfer, write_example
from pipeline.experiments.flights import check_flights, run_flights
from pipeline.experiments.paper import LARGEST_SIZE, NETWORK_SIZE
from pipeline.experiments.parts import FinishedParts
from pipeline.experiments.records import NODES, OPTIMIZERS, TIME_STEP
from pipeline.experiments.trials import (
    Comparison,
    EvaluatedPlanner,
    run_transfer_times,
    run_trials,
    variations,
)
from pipeline.experiments.verdicts import DECOUPLED
from pipeline.experiments.warmstart import run_warmstarts
from pipeline.networks.device import torch_device
from pipeline.networks.model import Model
from pipeline.networks.recipes import MOST, REFINER
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import ALL_CORES, Workers
from pipeline.plan.requirements import Requirements
from pipeline.planners.classical import BASELINES, Expert
from pipeline.planners.network import FallbackPlanner, NetworkPlanner, check_problem
from pipeline.progress import SILENT, Progress
from pipeline.scenario import Scenario
from pipeline.scratch import scratch_folder
from pipeline.storage.folder import Where
from pipeline.text import public_url
from registry.environment import EVALUATED_BY, with_architectures
from registry.models import ModelVersion, load, newest_trainings, resolve, table_names
from registry.results import Recorded, deciding, earlier_run, record, unfinished_parts
from registry.store import EVALUATION, FLIGHTS, TRANSFER_TIMES, WARMSTART

WARMSTART_SIZES = {"expert": "10,30", "plain": "10"}  # of swarms by default, by optimizer
FLOWN_BASELINES = ("minimum energy", DECOUPLED)
MOST_LARGER = 30  # scenarios of the paper's largest swarms that are flown, too
WEIGHTS_DIGITS = 16  # kept of each model's digest: MLflow limits a parameter to 6000 characters
FEWEST_NODES = 4  # of the shortest transfer that is replanned: with fewer the goal fixes controls


@dataclass(frozen=True, eq=False)
class EvaluatedNetwork:
    """A registered network in the experiments, named by version too where trainings differ."""

    model: Model
    version: ModelVersion
    name: str
    problem: Problem  # of the scenarios, which may be another than the training's

    @property
    def evaluated(self) -> EvaluatedPlanner:
        """The network flown and as predicted, for workers, which need no MLflow.

        InputError where its weights do not fit the problem.
        """
        planner, of = NetworkPlanner(self.model, self.name), self.version
        predict = self.model.on(self.problem).predict
        return EvaluatedPlanner(planner, of.recipe, of.training_seed, predict)


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
        found.append(EvaluatedNetwork(model, version, names[version.uri], manifest.problem))
    return found


def classical_planners() -> list[EvaluatedPlanner]:
    """The expert, with separation at all times and at nodes only, and the baselines."""
    at_nodes = Expert(name="expert (nodes only)", requirements=Requirements("nodes"))
    return [EvaluatedPlanner(planner) for planner in (Expert(), at_nodes, *BASELINES)]


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Test scenarios of a dataset, and the networks that are tried on them."""

    settings: ExperimentSettings
    digest: str  # of the dataset's content
    scenarios: Mapping[int, Sequence[Scenario]]  # by swarm size
    networks: Sequence[EvaluatedNetwork]

    def run(
        self,
        experiment: str,
        params: Mapping[str, Any],
        make: Callable[..., pd.DataFrame],
        *,
        resume: bool,
        progress: Progress,
        files: Path | None = None,
    ) -> Recorded:
        """Run and record an experiment; with ``resume``, continue or return an earlier run.

        ``params`` are parameters beside the settings. ``make`` is given the finished parts as
        ``kept`` and makes the table, a row for each trial; ``files`` is where it puts other files.
        """
        weights = [network.model.digest for network in self.networks]
        params = {
            **vars(self.settings),
            "dataset_digest": self.digest,
            "trials": max(map(len, self.scenarios.values())),
            "models": listed(network.version.uri for network in self.networks),
            "weights": ",".join(digest[:WEIGHTS_DIGITS] for digest in weights),
            **params,
        }
        by = with_architectures(EVALUATED_BY, (one.model.architecture for one in self.networks))
        if resume and (earlier := earlier_run(experiment, params, progress, by)):
            return Recorded(earlier, earlier=True)
        decided = {"params": deciding(params), "networks": weights}
        with unfinished_parts(experiment, decided, by, resume=resume, progress=progress) as kept:
            table, used = make(kept=kept), (self.settings.data, self.digest)
            # Last, since a finished run is what ``resume`` looks for.
            return Recorded(record(experiment, table, by, params=params, files=files, dataset=used))


def held_out(
    settings: ExperimentSettings,
    sizes: Sequence[int] | None,
    arch: str = "",
    device: str | None = None,
    circle_only: str = "",
) -> HeldOut:
    """The test scenarios of an experiment, of all sizes by default, and its networks.

    Networks are those of ``networks``. ``circle_only`` is why scenarios about an orbit that is no
    circle cannot take part, where that is so. InputError for these, and for models or sizes that
    cannot.
    """
    data, trials = settings.data, settings.trials
    if trials is not None:
        check_whole("trials", trials, 1, MOST)
    manifest, scenarios = read_manifest(data), {}
    if circle_only and manifest.problem.orbit is not None:
        raise InputError(
            f"the scenarios of {public_url(data)} are about an orbit of their own; expected ones "
            f"about a circle, since {circle_only}: sample some by --altitude."
        )
    for n in sizes or sorted(manifest.samples):
        found = solved_scenarios(data, n, "test")
        if not found:
            raise without_rows(data, f"test scenarios of n={n}")
        scenarios[n] = found[:trials]
    chosen = networks(name_list(settings.models), data, arch, device)
    return HeldOut(settings, manifest.digest(), scenarios, chosen)


def check_device(name: str | None, workers: Workers) -> None:
    """Raise InputError for a torch device that workers of this machine would not have."""
    if name is not None and workers.scheduler is None:
        torch_device(name)


def listed(values: Iterable[object]) -> str:
    """Distinct values joined by commas, as a parameter of a run."""
    return ",".join(dict.fromkeys(map(str, values)))


def evaluate(
    settings: Evaluation, *, workers: Workers = ALL_CORES, resume: bool = False
) -> Recorded:
    """Experiments 1 and 2: networks, expert and baselines plan the same scenarios."""
    check_whole("timed", settings.timed, 0, MOST)
    check_device(settings.device, workers)
    sizes = None if settings.sizes is None else int_list(settings.sizes)
    inputs = held_out(settings, sizes, device=settings.device)
    scenarios = inputs.scenarios
    planners = [*classical_planners(), *(network.evaluated for network in inputs.networks)]

    def run(kept: FinishedParts) -> pd.DataFrame:
        sizes = [Comparison(planners, some, f"n={n}") for n, some in scenarios.items()]
        tables = run_trials(sizes, timed=settings.timed, workers=workers, kept=kept)
        table = pd.concat(tables, ignore_index=True)
        drawn = scenarios[min(scenarios, key=lambda n: abs(n - NETWORK_SIZE))][0]
        for network in inputs.networks:
            used = settings.data, inputs.digest
            add_to_model(network.version, network.evaluated, table, drawn, used)
        write_example(example_transfer(drawn, planners), files / "example.npz")
        return table

    params = {
        "sizes": listed(sorted(scenarios)),
        "planners": listed(planner.label for planner in planners),
    }
    told = workers.progress
    with scratch_folder() as files:
        return inputs.run(EVALUATION, params, run, resume=resume, progress=told, files=files)


def warmstart(
    settings: WarmStarts, *, resume: bool = False, progress: Progress = SILENT
) -> Recorded:
    """Experiment 3: an optimizer is started from every seed; each optimizer has its own runs."""
    optimizer = settings.optimizer
    check_choice("optimizer", optimizer, OPTIMIZERS)
    sizes = WARMSTART_SIZES[optimizer] if settings.sizes is None else settings.sizes
    inputs = held_out(settings, int_list(sizes))
    scenarios = inputs.scenarios
    each = [one.evaluated for one in inputs.networks]
    seeds = {(one.label, one.training_seed): one.predictor for one in each if one.predictor}
    run = partial(run_warmstarts, seeds, list(scenarios.values()), optimizer, progress=progress)
    params = {"sizes": listed(scenarios), "seeds": listed(label for label, _ in seeds)}
    return inputs.run(WARMSTART, params, run, resume=resume, progress=progress)


def transfer_times(
    settings: TransferTimes, *, workers: Workers = ALL_CORES, resume: bool = False
) -> Recorded:
    """Experiment 4: the same ends with other transfer times."""
    nodes, steps = int_list(settings.nodes, "--nodes"), settings.time_steps
    time_steps = None if steps is None else sorted({*numbers(steps, "--time-step")})
    check_device(settings.device, workers)
    why = "about others the states that do not drift depend on the time"
    inputs = held_out(settings, [settings.n], device=settings.device, circle_only=why)
    scenarios = inputs.scenarios[settings.n]
    varied = variations(scenarios[0].problem, nodes, time_steps)

    def planners(problem: Problem) -> list[EvaluatedPlanner]:
        fitting = classical_planners()
        for network in inputs.networks:
            with suppress(InputError):  # its weights are for another T
                fitting.append(replace(network, problem=problem).evaluated)
        return fitting

    run = partial(run_transfer_times, planners, scenarios, varied, workers=workers)
    params = {
        "nodes": listed(one.nodes for what, one in varied if what == NODES),
        "time_steps": listed(
            str(one.time_step).removesuffix(".0") for what, one in varied if what == TIME_STEP
        ),
        "networks": listed(one.evaluated.label for one in inputs.networks),
    }
    return inputs.run(TRANSFER_TIMES, params, run, resume=resume, progress=workers.progress)


def flights(settings: Flights, *, workers: Workers = ALL_CORES, resume: bool = False) -> Recorded:
    """Experiment 5: plans are flown, those of networks made safe first where they are not.

    Swarms of the paper's largest size fly, too, where the dataset has any.
    """
    check_flights(settings.flights, settings.seed)
    why = "flights are about orbits of several eccentricities"
    # A refiner alone, since the paper's networks read one T.
    inputs = held_out(settings, [settings.n], REFINER, circle_only=why)
    scenarios, larger = inputs.scenarios[settings.n], []
    if settings.n < LARGEST_SIZE and LARGEST_SIZE in read_manifest(settings.data).samples:
        larger = solved_scenarios(settings.data, LARGEST_SIZE, "test")
        larger = larger[: min(MOST_LARGER, settings.trials or MOST_LARGER)]
    baselines = [EvaluatedPlanner(one) for one in BASELINES if one.name in FLOWN_BASELINES]
    shortest = replace(scenarios[0].problem, nodes=FEWEST_NODES)
    for network in inputs.networks:
        network.model.on(shortest)  # refuses weights that fit one T alone
    safe = [
        replace(one, planner=FallbackPlanner(one.planner), predictor=None)
        for one in (network.evaluated for network in inputs.networks)
    ]
    run = partial(
        run_flights,
        [EvaluatedPlanner(Expert()), *baselines, *safe],
        scenarios,
        flights=settings.flights,
        larger=larger,
        seed=settings.seed,
        workers=workers,
    )
    params = {"networks": listed(one.evaluated.label for one in inputs.networks)}
    params["larger"] = f"{len(larger)} of n={LARGEST_SIZE}" if larger else ""
    return inputs.run(FLIGHTS, params, run, resume=resume, progress=workers.progress)
