"""Experiments 1 and 2 on the test split of a dataset, recorded for the report and the UI."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from cli.stages.entrants import networks, unlearned
from cli.stages.model_results import add_to_model
from pipeline.dataset.reading.read import solved_rows
from pipeline.dataset.storage.folder import Where
from pipeline.dataset.storage.manifest import read_manifest
from pipeline.dataset.storage.schema import scenarios_of
from pipeline.errors import InputError
from pipeline.experiments.examples.run import Example, example_transfer, label_of
from pipeline.experiments.trials import run_trials
from pipeline.progress import SILENT, Progress
from pipeline.scenario import Scenario
from pipeline.urls import public_url
from registry.results import Done, earlier_run, record
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
        references: models; none means the newest trainings on the data, of each seed.
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
    manifest = read_manifest(data)
    digest = manifest.digest()
    chosen = list(sizes) if sizes else sorted(manifest.samples)
    scenarios = {n: test_scenarios(data, n, trials) for n in chosen}
    learned = networks(references, data)
    entrants = unlearned() + [network.entrant for network in learned]
    params = {
        "data": str(data),
        "dataset_digest": digest,
        "sizes": ",".join(str(n) for n in sorted(scenarios)),
        "trials": max(len(s) for s in scenarios.values()),
        "timed": timed,
        "planners": ",".join(dict.fromkeys(label_of(e) for e in entrants)),
        "models": ",".join(network.version.uri for network in learned),
    }
    if resume and (earlier := earlier_run(EVALUATION, params, progress=progress)):
        return Done(earlier, earlier=True)
    progress.expect(len(chosen) * len(entrants))
    tables = [
        run_trials(
            entrants,
            scenarios[n],
            timed=min(timed, len(scenarios[n])),
            progress=progress,
        )
        for n in chosen
    ]
    table = pd.concat(tables, ignore_index=True)
    drawn = scenarios[min(chosen, key=lambda n: abs(n - 10))][0]
    for network in learned:
        add_to_model(network, table, drawn, data, digest)
    # Last, since a finished run is what ``resume`` looks for.
    return Done(_record(table, params, example_transfer(drawn, entrants), data, digest))


def test_scenarios(data: Where, n: int, trials: int | None = None) -> list[Scenario]:
    """Scenarios of the test split of one size, in order of their index.

    Raises:
        InputError: where there are none, or none are asked for.
    """
    if trials is not None and trials < 1:
        raise InputError(f"trials is {trials}; expected at least 1.")
    columns = ("scenario_id", "n_spacecraft", "family", "initial", "goal")
    found = scenarios_of(solved_rows(data, n, "test", columns))
    if not found:
        where = public_url(data)
        raise InputError(f"{where} has no test scenarios of n={n}; expected some: sample more.")
    return found[:trials]


def _record(
    table: pd.DataFrame, params: Mapping[str, Any], example: Example, data: Where, digest: str
) -> str:
    tracks: dict[str, Any] = {f"track:{k}": v for k, v in example.tracks.items()}
    with TemporaryDirectory(prefix="prolearn-") as scratch:
        np.savez_compressed(
            Path(scratch) / "example.npz",
            initial=example.initial,
            goal=example.goal,
            name=np.array(example.title),
            collision_radius=np.array(example.collision_radius),
            **tracks,
        )
        return record(
            EVALUATION, table, params=params, files=Path(scratch), dataset=(str(data), digest)
        )
