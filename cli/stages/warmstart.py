"""Experiment 3 on the test split of a dataset, recorded for the report."""

from collections.abc import Sequence

import pandas as pd

from cli.stages.entrants import networks
from cli.stages.evaluate import test_scenarios
from pipeline.dataset.storage.folder import Where
from pipeline.dataset.storage.manifest import read_manifest
from pipeline.errors import InputError
from pipeline.experiments.experiment3.rows import EXPERT, OPTIMIZERS
from pipeline.experiments.experiment3.run import run_warmstarts
from pipeline.progress import SILENT, Progress
from registry.results import Done, earlier_run, record
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
        references: models; none means the newest trainings on the data, of each seed.
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
    scenarios = {n: test_scenarios(data, n, trials) for n in sizes}
    learned = networks(references, data)
    predictors = {(net.label, net.version.training_seed): net.model for net in learned}
    digest = read_manifest(data).digest()
    params = {
        "optimizer": optimizer,
        "data": str(data),
        "dataset_digest": digest,
        "sizes": ",".join(str(n) for n in sizes),
        "trials": max(len(s) for s in scenarios.values()),
        "seeds": ",".join(dict.fromkeys(label for label, _ in predictors)),
        "models": ",".join(network.version.uri for network in learned),
    }
    if resume and (earlier := earlier_run(WARMSTART, params, ["optimizer"], progress)):
        return Done(earlier, earlier=True)
    progress.expect(sum(map(len, scenarios.values())))
    tables = [run_warmstarts(predictors, scenarios[n], optimizer, progress=progress) for n in sizes]
    used = (str(data), digest)
    table = pd.concat(tables, ignore_index=True)
    return Done(record(WARMSTART, table, params=params, dataset=used))
