"""Experiment 3 on the test split of a dataset, recorded for the report."""

from collections.abc import Callable, Sequence

import pandas as pd

from pipeline.dataset.folder import Where
from pipeline.dataset.manifest import read_manifest
from pipeline.evaluation.warmstart import run_warmstarts
from registry.jobs.entrants import networks
from registry.jobs.evaluate import test_scenarios
from registry.results import Outcome, earlier_run, record
from registry.store import WARMSTART


def warmstart(
    references: Sequence[str],
    data: Where,
    *,
    sizes: Sequence[int],
    trials: int,
    resume: bool = False,
    report: Callable[[int], None] = lambda trials: None,
) -> Outcome:
    """Start the expert from every seed on the same scenarios, and record it.

    Args:
        references: models; none means the newest of each architecture, recipe and seed.
        data: a solved dataset.
        sizes: swarm sizes.
        trials: most scenarios of a size.
        resume: leave it where it was done before, with the same data, models and settings.
        report: called after each scenario.

    Raises:
        InputError: for unknown models or sizes that are not in the dataset.
        ProlearnError: where the store fails.
    """
    scenarios = {n: test_scenarios(data, n, trials) for n in sizes}
    learned = networks(references)
    predictors = {(net.label, net.version.training_seed): net.model for net in learned}
    digest = read_manifest(data).digest()
    params = {
        "data": str(data),
        "dataset_digest": digest,
        "sizes": ",".join(str(n) for n in sizes),
        "trials": max(len(s) for s in scenarios.values()),
        "seeds": ",".join(dict.fromkeys(label for label, _ in predictors)),
        "models": ",".join(network.version.uri for network in learned),
    }
    if resume and (earlier := earlier_run(WARMSTART, params)):
        return Outcome(earlier, earlier=True)
    tables = [run_warmstarts(predictors, scenarios[n], report=lambda: report(1)) for n in sizes]
    used = (str(data), digest)
    table = pd.concat(tables, ignore_index=True)
    return Outcome(record(WARMSTART, table, params=params, dataset=used))
