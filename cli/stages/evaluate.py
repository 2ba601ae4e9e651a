"""Experiments 1 and 2 on the test split of a dataset, recorded for the report and the UI."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from cli.stages.entrants import unlearned
from cli.stages.experiment import held_out, listed
from cli.stages.model_results import add_to_model
from pipeline.errors import InputError
from pipeline.experiments.paper import NETWORK_SIZE
from pipeline.experiments.trials import example_transfer, run_trials, write_example
from pipeline.progress import SILENT, Progress
from pipeline.storage.folder import Where
from registry.results import Done
from registry.store import EVALUATION


def evaluate(
    references: Sequence[str],
    data: Where,
    *,
    sizes: Sequence[int] | None,
    trials: int | None,
    timed: int,
    resume: bool = False,
    progress: Progress = SILENT,
) -> Done:
    """Evaluate networks, expert and baselines, and record it.

    Args:
        references: models, as for ``held_out``.
        data: a solved dataset.
        sizes: swarm sizes, or all of the dataset.
        trials: most test scenarios of a size, or all.
        timed: scenarios of each size that are timed one at a time.
        resume: leave it where it was done before, with the same data, models and settings.
        progress: told of each planner's trials of a size, and where other versions did it before.

    Raises:
        InputError: for unknown models, sizes that are not in the dataset, trials < 1 or timed < 0.
        ProlearnError: where the store fails.
    """
    if timed < 0:
        raise InputError(f"timed is {timed}; expected 0 or more trials to time.")
    ground = held_out(references, data, sizes, trials)
    scenarios = ground.scenarios
    entrants = unlearned() + [network.entrant for network in ground.networks]

    def run(files: Path) -> pd.DataFrame:
        progress.expect(len(scenarios) * len(entrants))
        tables = [
            run_trials(entrants, some, timed=min(timed, len(some)), progress=progress)
            for some in scenarios.values()
        ]
        table = pd.concat(tables, ignore_index=True)
        drawn = scenarios[min(scenarios, key=lambda n: abs(n - NETWORK_SIZE))][0]
        for network in ground.networks:
            add_to_model(network, table, drawn, data, ground.digest)
        write_example(example_transfer(drawn, entrants), files / "example.npz")
        return table

    params = {
        "sizes": listed(sorted(scenarios)),
        "timed": timed,
        "planners": listed(entrant.label for entrant in entrants),
    }
    return ground.run(EVALUATION, params, run, resume=resume, progress=progress)
