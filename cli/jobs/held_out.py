"""Test scenarios of a dataset with the networks tried on them, and an experiment's MLflow run."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from cli.jobs.networks import Choice, EvaluatedNetwork, networks, planners_on
from cli.options import name_list
from cli.settings import ExperimentSettings
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.reading import solved_rows
from pipeline.dataset.schema import scenarios_of
from pipeline.errors import InputError
from pipeline.progress import Progress
from pipeline.scenario import Scenario
from pipeline.scratch import scratch_folder
from pipeline.urls import public_url
from registry.results import Done, earlier_run, record

COLUMNS = ("scenario_id", "n_spacecraft", "family", "initial", "goal")


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Test scenarios of a dataset, and the networks that are tried on them."""

    settings: ExperimentSettings
    digest: str  # of the dataset's content
    scenarios: Mapping[int, Sequence[Scenario]]  # by swarm size
    networks: Sequence[EvaluatedNetwork]

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
        """Run an experiment and record it, or find its earlier run where ``resume`` is given.

        Args:
            experiment: of EXPERIMENTS but TRAINING.
            params: parameters of the run that its settings leave open or do not have.
            make: gives a row for each trial, and leaves files for the run in a folder.
            kind: settings that tell kinds of its runs apart.
            resume: leave it where its newest run had the same settings and versions.
            progress: told where other versions did it before.
        """
        params = {
            **vars(self.settings),
            "dataset_digest": self.digest,
            "trials": max(map(len, self.scenarios.values())),
            "models": listed(network.version.uri for network in self.networks),
            **params,
        }
        if resume and (earlier := earlier_run(experiment, params, kind, progress)):
            return Done(earlier, earlier=True)
        with scratch_folder() as scratch:
            table, used = make(scratch), (self.settings.data, self.digest)
            # Last, since a finished run is what ``resume`` looks for.
            return Done(record(experiment, table, params=params, files=scratch, dataset=used))


def held_out(
    settings: ExperimentSettings, sizes: Sequence[int] | None, choice: Choice = planners_on
) -> HeldOut:
    """The test scenarios and networks of an experiment; of each size the first scenarios by index.

    Without sizes those of the dataset, and without models in the settings ``choice`` takes part.

    Raises:
        InputError: for unknown models or models of another problem than the data's, for sizes
            that are not in the dataset, or trials < 1.
    """
    data, trials = settings.data, settings.trials
    if trials is not None and trials < 1:
        raise InputError(f"trials is {trials}; expected at least 1.")
    manifest = read_manifest(data)
    scenarios = {}
    for n in sizes or sorted(manifest.samples):
        found = scenarios_of(solved_rows(data, n, "test", COLUMNS))
        if not found:
            raise InputError(
                f"{public_url(data)} has no test scenarios of n={n}; expected some: sample more."
            )
        scenarios[n] = found[:trials]
    chosen = networks(name_list(settings.models), data, choice)
    return HeldOut(settings, manifest.digest(), scenarios, chosen)


def listed(values: Iterable[object]) -> str:
    """Distinct values joined by commas, as a parameter of a run."""
    return ",".join(dict.fromkeys(map(str, values)))
