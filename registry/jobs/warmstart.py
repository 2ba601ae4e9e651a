"""Experiment 3 on the test split of a dataset, recorded for the report."""

from collections.abc import Callable, Sequence

import pandas as pd

from pipeline.dataset.folder import Where
from pipeline.dataset.manifest import read_manifest
from pipeline.evaluation.warmstart import run_warmstarts
from registry.jobs.entrants import networks
from registry.jobs.evaluate import test_scenarios
from registry.results import record_warmstart


def warmstart(
    references: Sequence[str],
    data: Where,
    *,
    sizes: Sequence[int],
    trials: int,
    report: Callable[[int], None] = lambda trials: None,
) -> str:
    """Start the expert from every seed on the same scenarios, and record it.

    Args:
        references: models; none means the newest of each architecture and recipe.
        data: a solved dataset.
        sizes: swarm sizes.
        trials: most scenarios of a size.
        report: called after each scenario.

    Returns:
        The id of the MLflow run.

    Raises:
        InputError: for unknown models or sizes that are not in the dataset.
        ProlearnError: where the store fails.
    """
    scenarios = {n: test_scenarios(data, n, trials) for n in sizes}
    learned = networks(references)
    predictors = {network.label: network.model for network in learned}
    tables = [run_warmstarts(predictors, scenarios[n], report=lambda: report(1)) for n in sizes]
    digest = read_manifest(data).digest()
    params = {
        "data": str(data),
        "dataset_digest": digest,
        "sizes": ",".join(str(n) for n in sizes),
        "trials": max(len(s) for s in scenarios.values()),
        "seeds": ",".join(predictors),
    }
    used = (str(data), digest)
    return record_warmstart(pd.concat(tables, ignore_index=True), params=params, dataset=used)
