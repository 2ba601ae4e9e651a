"""Experiment 3 on the test split of a dataset, recorded for the report."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from cli.stages.experiment import held_out, listed
from pipeline.errors import InputError
from pipeline.experiments.records import EXPERT, OPTIMIZERS
from pipeline.experiments.warmstart import run_warmstarts
from pipeline.progress import SILENT, Progress
from pipeline.storage.folder import Where
from registry.results import Done
from registry.store import WARMSTART


def warmstart(
    references: Sequence[str],
    data: Where,
    *,
    sizes: Sequence[int],
    trials: int,
    optimizer: str = EXPERT,
    resume: bool = False,
    progress: Progress = SILENT,
) -> Done:
    """Start an optimizer from every seed on the same scenarios, and record it.

    Args:
        references: models, as for ``held_out``.
        data: a solved dataset.
        sizes: swarm sizes.
        trials: most scenarios of a size.
        optimizer: of OPTIMIZERS; each has runs of its own.
        resume: leave it where it was done before, with the same optimizer, data, models and
            settings.
        progress: told of each scenario, and where other versions did it before.

    Raises:
        InputError: for an unknown optimizer, unknown models or sizes that are not in the dataset.
        ProlearnError: where the store fails.
    """
    if optimizer not in OPTIMIZERS:
        raise InputError(f"optimizer is {optimizer!r}; expected one of {', '.join(OPTIMIZERS)}.")
    ground = held_out(references, data, sizes, trials)
    scenarios = ground.scenarios
    seeds = {(net.label, net.version.training_seed): net.model for net in ground.networks}

    def run(_: Path) -> pd.DataFrame:
        progress.expect(sum(map(len, scenarios.values())))
        tables = [
            run_warmstarts(seeds, some, optimizer, progress=progress) for some in scenarios.values()
        ]
        return pd.concat(tables, ignore_index=True)

    params = {
        "optimizer": optimizer,
        "sizes": listed(scenarios),
        "seeds": listed(label for label, _ in seeds),
    }
    return ground.run(WARMSTART, params, run, kind=["optimizer"], resume=resume, progress=progress)
