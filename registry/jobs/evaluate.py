"""Experiments 1 and 2 on the test split of a dataset, recorded for the report and the UI."""

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from pipeline.dataset.folder import Where
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.read import solved_rows
from pipeline.dataset.schema import scenarios_of
from pipeline.errors import InputError
from pipeline.evaluation.trials import Entrant, run_trials
from pipeline.orbit.transfer import track
from pipeline.report.summary import summarize
from pipeline.scenario import Scenario
from registry.jobs.entrants import Network, networks, unlearned
from registry.results import add_model_metrics, record_evaluation

TRACK_STEPS = 12
"""Points an interval in the example transfers."""

COMPARED = {
    "collisions": "collisions_mean",
    "collisions_max": "collisions_max",
    "fuel": "fuel_mean",
    "fuel_ratio": "fuel_ratio",
    "safe_share": "safe_share",
    "boundary_error": "boundary_error",
    "dynamics_error": "dynamics_error",
    "seconds": "seconds_mean",
}
"""Metrics of a model's run, by the column of the summary that they come from."""


def evaluate(
    references: Sequence[str],
    data: Where,
    *,
    sizes: Sequence[int] | None,
    trials: int | None,
    timed: int,
    report: Callable[[str], None] = lambda stage: None,
) -> str:
    """Evaluate networks, expert and baselines, and record it; returns the run's id.

    Args:
        references: models; none means the newest of each architecture and recipe.
        data: a solved dataset.
        sizes: swarm sizes, or all of the dataset.
        trials: most test scenarios of a size, or all.
        timed: scenarios of each size that are timed one at a time.
        report: called with a planner's turn before each swarm size.

    Raises:
        InputError: for unknown models, sizes that are not in the dataset, or trials < 1.
        ProlearnError: where the store fails.
    """
    if trials is not None and trials < 1:
        raise InputError(f"trials is {trials}; expected at least 1.")
    manifest = read_manifest(data)
    chosen = list(sizes) if sizes else sorted(manifest.samples)
    scenarios = {n: test_scenarios(data, n, trials) for n in chosen}
    learned = networks(references)
    entrants = unlearned() + [network.entrant for network in learned]
    tables = []
    for n in chosen:
        report(f"n={n}")
        tables.append(run_trials(entrants, scenarios[n], timed=min(timed, len(scenarios[n]))))
    table = pd.concat(tables, ignore_index=True)
    run_id = _record(table, entrants, scenarios, data, manifest.digest())
    _add_to_models(learned, table)
    return run_id


def test_scenarios(data: Where, n: int, trials: int | None = None) -> list[Scenario]:
    """Scenarios of the test split of one size, in order of their index.

    Raises:
        InputError: where there are none.
    """
    columns = ("scenario_id", "n_spacecraft", "family", "initial", "goal")
    found = scenarios_of(solved_rows(data, n, "test", columns))
    if not found:
        raise InputError(f"{data} has no test scenarios of n={n}; expected some: sample more.")
    return found[:trials]


def _record(
    table: pd.DataFrame,
    entrants: Sequence[Entrant],
    scenarios: dict[int, list[Scenario]],
    data: Where,
    digest: str,
) -> str:
    sizes = sorted(scenarios)
    params = {
        "data": str(data),
        "dataset_digest": digest,
        "sizes": ",".join(str(n) for n in sizes),
        "trials": max(len(s) for s in scenarios.values()),
        "planners": ",".join(f"{e.planner.name} {e.recipe}".strip() for e in entrants),
    }
    shown = scenarios[min(sizes, key=lambda n: abs(n - 10))][0]
    with TemporaryDirectory(prefix="prolearn-") as scratch:
        _write_example(Path(scratch) / "example.npz", shown, entrants)
        return record_evaluation(table, params=params, files=Path(scratch))


def _write_example(path: Path, scenario: Scenario, entrants: Sequence[Entrant]) -> None:
    """One transfer as every planner flies it: positions dense in time, by label."""
    tracks: dict[str, Any] = {}
    for entrant in entrants:
        plan = entrant.planner.plan([scenario])[0]
        label = f"{entrant.planner.name} {entrant.recipe}".strip()
        tracks[f"track:{label}"] = track(plan.states, plan.controls, scenario.problem, TRACK_STEPS)
    np.savez_compressed(
        path,
        initial=scenario.initial,
        goal=scenario.goal,
        name=np.array(scenario.name),
        collision_radius=np.array(scenario.problem.collision_radius),
        **tracks,
    )


def _add_to_models(learned: Sequence[Network], table: pd.DataFrame) -> None:
    """Metrics in each model's own run: experiment 1 by name, experiment 2 with n as the step."""
    summary = summarize(table)
    for network in learned:
        version = network.version
        mine = summary[(summary.planner == version.arch) & (summary.recipe == version.recipe)]
        for _, row in mine.iterrows():
            found = {
                f"{row.reading}_{metric}": float(row[column])
                for metric, column in COMPARED.items()
                if pd.notna(row[column])
            }
            n = int(row.n)
            if n == network.model.n_train:
                add_model_metrics(version, {f"exp1_{k}": v for k, v in found.items()})
            add_model_metrics(version, {f"exp2_{k}": v for k, v in found.items()}, step=n)
