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
from pipeline.report.results import Example
from pipeline.report.summary import summarize
from pipeline.scenario import Scenario
from registry.jobs.entrants import networks, unlearned
from registry.jobs.model_results import add_to_model
from registry.results import record_evaluation

TRACK_STEPS = 12
"""Points an interval in the example transfers."""


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
        InputError: for unknown models, sizes that are not in the dataset, trials < 1 or timed < 0.
        ProlearnError: where the store fails.
    """
    if timed < 0:
        raise InputError(f"timed is {timed}; expected 0 or more trials to time.")
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
    example = _example(scenarios[min(chosen, key=lambda n: abs(n - 10))][0], entrants)
    digest = manifest.digest()
    run_id = _record(table, entrants, scenarios, example, data, digest)
    summary = summarize(table)
    for network in learned:
        add_to_model(network, summary, example, data, digest)
    return run_id


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
        raise InputError(f"{data} has no test scenarios of n={n}; expected some: sample more.")
    return found[:trials]


def _record(
    table: pd.DataFrame,
    entrants: Sequence[Entrant],
    scenarios: dict[int, list[Scenario]],
    example: Example,
    data: Where,
    digest: str,
) -> str:
    params = {
        "data": str(data),
        "dataset_digest": digest,
        "sizes": ",".join(str(n) for n in sorted(scenarios)),
        "trials": max(len(s) for s in scenarios.values()),
        "planners": ",".join(_label(e) for e in entrants),
    }
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
        return record_evaluation(
            table, params=params, files=Path(scratch), dataset=(str(data), digest)
        )


def _example(scenario: Scenario, entrants: Sequence[Entrant]) -> Example:
    """One transfer as every planner flies it: positions dense in time, by label."""
    tracks = {}
    for entrant in entrants:
        plan = entrant.planner.plan([scenario])[0]
        flown = track(plan.states, plan.controls, scenario.problem, TRACK_STEPS)
        tracks[_label(entrant)] = flown
    radius = scenario.problem.collision_radius
    return Example(scenario.name, scenario.initial, scenario.goal, tracks, radius)


def _label(entrant: Entrant) -> str:
    return f"{entrant.planner.name} {entrant.recipe}".strip()
