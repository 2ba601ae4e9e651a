"""Experiment 4 on the test split of a dataset, recorded for the report."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pandas as pd

from cli.stages.entrants import unlearned
from cli.stages.experiment import held_out, listed
from pipeline.errors import InputError
from pipeline.experiments.records import NODES, TIME_STEP
from pipeline.experiments.trials import EvaluatedPlanner, run_transfer_times, variations
from pipeline.orbit.problem import Problem
from pipeline.progress import SILENT, Progress
from pipeline.storage.folder import Where
from registry.results import Done
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
        references: models, as for ``held_out``.
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
    ground = held_out(references, data, [n], trials)
    scenarios = ground.scenarios[n]
    varied = variations(scenarios[0].problem, nodes, time_steps)

    def entrants(problem: Problem) -> list[EvaluatedPlanner]:
        """Experts and baselines, which plan for any problem, and the networks that fit it."""
        fitting = unlearned()
        for network in ground.networks:
            with suppress(InputError):  # its weights are for another T
                fitting.append(replace(network, model=network.model.on(problem)).entrant)
        return fitting

    def run(_: Path) -> pd.DataFrame:
        progress.expect(len(varied))
        return run_transfer_times(entrants, scenarios, varied, progress=progress)

    params = {
        "n": n,
        "nodes": listed(v.problem.nodes for v in varied if v.varied == NODES),
        "time_steps": listed(f"{v.problem.time_step:.9g}" for v in varied if v.varied == TIME_STEP),
        "networks": listed(network.label for network in ground.networks),
    }
    return ground.run(TRANSFER_TIMES, params, run, resume=resume, progress=progress)
