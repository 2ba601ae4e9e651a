"""What the experiments have in common: scenarios that no network has seen, and a run of MLflow."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from cli.stages.entrants import Choice, Network, networks, planners_on
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.reading import solved_rows
from pipeline.dataset.schema import scenarios_of
from pipeline.errors import InputError
from pipeline.progress import Progress
from pipeline.scenario import Scenario
from pipeline.scratch import scratch_folder
from pipeline.storage.folder import Where
from pipeline.urls import public_url
from registry.results import Done, earlier_run, record


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Test scenarios of a dataset, and the networks that are tried on them.

    Attributes:
        data: the dataset.
        digest: of its content.
        scenarios: by swarm size.
        networks: registered ones.
    """

    data: Where
    digest: str
    scenarios: Mapping[int, Sequence[Scenario]]
    networks: Sequence[Network]

    def run(
        self,
        experiment: str,
        params: Mapping[str, Any],
        make: Callable[[Path], pd.DataFrame],
        *,
        kind: Sequence[str] = (),
        resume: bool,
        progress: Progress,
    ) -> Done:
        """Run an experiment and record it, unless it was done before and that will do.

        Args:
            experiment: of EXPERIMENTS but TRAINING.
            params: its settings, beside data, models and trials.
            make: gives a row for each trial, and leaves files for the run in a folder.
            kind: settings that tell kinds of its runs apart.
            resume: leave it where its newest run had the same settings and versions.
            progress: told where other versions did it before.

        Raises:
            ProlearnError: where the store fails.
        """
        params = {
            "data": str(self.data),
            "dataset_digest": self.digest,
            "trials": max(map(len, self.scenarios.values())),
            "models": listed(network.version.uri for network in self.networks),
            **params,
        }
        if resume and (earlier := earlier_run(experiment, params, kind, progress)):
            return Done(earlier, earlier=True)
        with scratch_folder() as scratch:
            table, used = make(scratch), (str(self.data), self.digest)
            # Last, since a finished run is what ``resume`` looks for.
            return Done(record(experiment, table, params=params, files=scratch, dataset=used))


def held_out(
    references: Sequence[str],
    data: Where,
    sizes: Sequence[int] | None,
    trials: int | None,
    choice: Choice = planners_on,
) -> HeldOut:
    """What an experiment is run on.

    Args:
        references: models; none means the newest trainings on the data, of each seed.
        data: a solved dataset.
        sizes: swarm sizes, or all of the dataset.
        trials: most scenarios of a size, the first by their index, or all.
        choice: which of the newest trainings.

    Raises:
        InputError: for unknown models or models of another problem than the data's, for sizes
            that are not in the dataset, or trials < 1.
        ProlearnError: where the store fails.
    """
    if trials is not None and trials < 1:
        raise InputError(f"trials is {trials}; expected at least 1.")
    manifest = read_manifest(data)
    scenarios = {n: _scenarios(data, n)[:trials] for n in sizes or sorted(manifest.samples)}
    return HeldOut(data, manifest.digest(), scenarios, networks(references, data, choice))


def listed(values: Iterable[object]) -> str:
    """Distinct values as a parameter of a run has them."""
    return ",".join(dict.fromkeys(map(str, values)))


def _scenarios(data: Where, n: int) -> list[Scenario]:
    columns = ("scenario_id", "n_spacecraft", "family", "initial", "goal")
    found = scenarios_of(solved_rows(data, n, "test", columns))
    if not found:
        where = public_url(data)
        raise InputError(f"{where} has no test scenarios of n={n}; expected some: sample more.")
    return found
