"""Experiment 4 on the test split of a dataset, recorded for the report."""

from collections.abc import Sequence
from dataclasses import replace

from cli.stages.entrants import Network, networks, unlearned
from cli.stages.evaluate import test_scenarios
from pipeline.dataset.storage.folder import Where
from pipeline.dataset.storage.manifest import read_manifest
from pipeline.errors import InputError
from pipeline.experiments.experiment4.run import (
    NODES,
    EntrantsOn,
    run_transfer_times,
    variations,
)
from pipeline.experiments.trials import Entrant
from pipeline.orbit.problem import Problem
from pipeline.progress import SILENT, Progress
from registry.results import Done, earlier_run, record
from registry.store import TRANSFER_TIMES


def transfer_times(
    references: Sequence[str],
    data: Where,
    *,
    n: int,
    nodes: Sequence[int],
    time_steps: Sequence[float] | None,
    trials: int,
    resume: bool = False,
    progress: Progress = SILENT,
) -> Done:
    """Give the same ends other transfer times, and record what becomes of every plan.

    Args:
        references: models; none means the newest trainings on the data, of each seed.
        data: a solved dataset.
        n: swarm size.
        nodes: numbers of nodes T, at the dataset's Δt.
        time_steps: Δt in s, at the dataset's T; None for the same transfer times.
        trials: most scenarios.
        resume: leave it where it was done before, with the same data, models and settings.
        progress: told of each transfer time, and where other versions did it before.

    Raises:
        InputError: for unknown models, models of another problem than the dataset's, a size
            that is not in it, or a T or Δt that no transfer has.
        ProlearnError: where the store fails.
    """
    scenarios = test_scenarios(data, n, trials)
    varied = variations(scenarios[0].problem, nodes, time_steps)
    learned = networks(references, data)
    digest = read_manifest(data).digest()
    params = {
        "data": str(data),
        "dataset_digest": digest,
        "n": n,
        "nodes": ",".join(str(v.problem.nodes) for v in varied if v.varied == NODES),
        "time_steps": ",".join(f"{v.problem.time_step:.9g}" for v in varied if v.varied != NODES),
        "trials": len(scenarios),
        "networks": ",".join(dict.fromkeys(network.label for network in learned)),
        "models": ",".join(network.version.uri for network in learned),
    }
    if resume and (earlier := earlier_run(TRANSFER_TIMES, params, progress=progress)):
        return Done(earlier, earlier=True)
    progress.expect(len(varied))
    table = run_transfer_times(_entrants_on(learned), scenarios, varied, progress=progress)
    return Done(record(TRANSFER_TIMES, table, params=params, dataset=(str(data), digest)))


def _entrants_on(learned: Sequence[Network]) -> EntrantsOn:
    """Experts and baselines, which plan for any problem, and the networks that fit it."""

    def entrants(problem: Problem) -> list[Entrant]:
        return unlearned() + [e for network in learned for e in _fitting(network, problem)]

    return entrants


def _fitting(network: Network, problem: Problem) -> list[Entrant]:
    """The network as an entrant; nothing where its weights are for another T."""
    try:
        return [replace(network, model=network.model.on(problem)).entrant]
    except InputError:
        return []
