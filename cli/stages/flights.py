"""Experiment 5 on the test split of a dataset, recorded for the report."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from cli.stages.entrants import Network, planners_on
from cli.stages.experiment import held_out, listed
from pipeline.experiments.flights import run_flights
from pipeline.experiments.trials import EvaluatedPlanner
from pipeline.experiments.verdicts import DECOUPLED
from pipeline.networks.refiner.ablations import REFINER
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers
from pipeline.planners.classical import BASELINES, Expert
from pipeline.planners.network import FallbackPlanner, NetworkPlanner
from pipeline.progress import SILENT, Progress
from pipeline.storage.folder import Where
from registry.results import Done
from registry.store import FLIGHTS
from registry.version import ModelVersion

FREE_PLANNERS = ("minimum energy", DECOUPLED)
"""Baselines that fly."""

SHORTEST = 4
"""Nodes of the shortest transfer that is planned anew: with fewer, the goal leaves no choice."""


def flights(
    references: Sequence[str],
    data: Where,
    *,
    n: int,
    trials: int,
    flights: int,
    seed: int = 0,
    jobs: int = -1,
    resume: bool = False,
    progress: Progress = SILENT,
) -> Done:
    """Fly the plans of expert, networks and baselines, and record what becomes of them.

    Args:
        references: networks that answer on any time grid; none means the newest refiners that were
            trained on the data.
        data: a solved dataset.
        n: swarm size.
        trials: most scenarios.
        flights: draws of errors for each scenario.
        seed: root seed of these.
        jobs: processes; -1 for one a core.
        resume: leave it where it was done before, with the same data, models and settings.
        progress: told of each scenario, and where other versions did it before.

    Raises:
        InputError: for unknown models, models that are of another problem than the dataset's or
            serve one number of nodes alone, a size that is not in it, or numbers of no use.
        ProlearnError: where the store fails.
    """
    workers = Workers(jobs)
    ground = held_out(references, data, [n], trials, refiners_on)
    scenarios = ground.scenarios[n]
    baselines = [EvaluatedPlanner(one) for one in BASELINES if one.name in FREE_PLANNERS]
    networks = [_safe(network, scenarios[0].problem) for network in ground.networks]
    entrants = [EvaluatedPlanner(Expert()), *baselines, *networks]

    def run(_: Path) -> pd.DataFrame:
        return run_flights(
            entrants,
            scenarios,
            flights=flights,
            seed=seed,
            workers=workers,
            progress=progress,
        )

    params = {
        "n": n,
        "flights": flights,
        "seed": seed,
        "networks": listed(network.label for network in ground.networks),
    }
    return ground.run(FLIGHTS, params, run, resume=resume, progress=progress)


def refiners_on(data: Where) -> list[ModelVersion]:
    """The newest refiners that were trained on a dataset; the paper's networks read one T alone.

    Raises:
        InputError: where there are models and none was trained on this data.
    """
    return [version for version in planners_on(data) if version.arch == REFINER]


def _safe(network: Network, problem: Problem) -> EvaluatedPlanner:
    """A network that is made safe by one convex solve or the expert where it is not.

    Raises:
        InputError: where its weights do not fit the transfers that are planned on the way.
    """
    network.model.on(replace(problem, nodes=SHORTEST))
    planner = FallbackPlanner(NetworkPlanner(network.model, network.name))
    return EvaluatedPlanner(planner, network.version.recipe, network.version.training_seed)
