"""Ablations of the refiner: what it is worth without each of its parts, recorded for the report.

    python -m benchmarks.ablate --data data/paper

Tries the newest refiner of each recipe (``prolearn train --arch refiner --recipe short``) and the
rule without a network, on the test split and on dense swarms; tuned, short and the rule after other
numbers of rounds, too. ``prolearn report`` shows the newest run, docs/refiner.md what came of one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import pandas as pd
import typer

from benchmarks.rule import rule, with_rounds
from cli.jobs.experiments import HeldOut, held_out, listed
from cli.jobs.networks import EvaluatedNetwork, newest_on
from cli.options import int_list, with_settings
from cli.progress import progress as shown_progress
from cli.settings import ExperimentSettings, Resume, option
from pipeline.errors import InputError
from pipeline.experiments.ablations import SHORT, TUNED
from pipeline.experiments.records import TABLES
from pipeline.experiments.trials import EvaluatedPlanner, run_trials
from pipeline.experiments.verdicts import DECOUPLED
from pipeline.planners.classical import BASELINES
from pipeline.progress import SILENT, Progress
from pipeline.scenario import Scenario, draw
from pipeline.storage.folder import Where
from pipeline.urls import public_url
from registry.models import ModelVersion
from registry.results import Done
from registry.store import ABLATIONS

DENSE, DENSE_CRAFT = "dense", 10
"""The family that is tried beside the data's, and spacecraft of each such swarm."""

DECOUPLED_OPTIMUM = next(planner for planner in BASELINES if planner.name == DECOUPLED)
"""What any refiner plans without a round."""


@dataclass(frozen=True)
class Ablations(ExperimentSettings):
    """Settings of the ablations; models are refiners, the newest by default."""

    sizes: Annotated[str, option("Swarm sizes.", "--n")] = "10,30"
    rounds: Annotated[str, option("Numbers of rounds.")] = "0,1,2,3,4,6,8,12,16,20,30"
    dense: Annotated[int, option("Swarms of the family dense.")] = 300
    timed: Annotated[int, option("Trials of each size that are timed.")] = 10


@with_settings
def main(settings: Ablations, resume: Resume = False) -> None:
    """Run all and record it."""
    with shown_progress("ablations") as progress:
        ablate(settings, resume=resume, progress=progress)


def ablate(settings: Ablations, *, resume: bool = False, progress: Progress = SILENT) -> Done:
    """Try refiners of all recipes and the rule alone after other numbers of rounds; record it.

    InputError for models that are no refiners or whose answers take different numbers of rounds,
    sizes that are not in the dataset, or bad numbers.
    """
    rounds, timed, dense = int_list(settings.rounds, "--rounds", 0), settings.timed, settings.dense
    if min(timed, dense) < 0:
        raise InputError(f"timed is {timed} and dense {dense}; expected 0 or more each.")
    ground = held_out(settings, int_list(settings.sizes), refiners_on)
    tried = [*ground.scenarios.values()]
    if swarms := dense_beside(ground, min(dense, settings.trials or dense)):
        tried.append(swarms)
    own = _common_rounds(ground.networks)
    counts = sorted({0, *rounds, own})
    by_count = {count: _planners(ground.networks, count, own) for count in counts}

    def run(_: object) -> pd.DataFrame:
        progress.expect(len(tried) * sum(map(len, by_count.values())))
        tables = []
        for scenarios in tried:
            for count, planners in by_count.items():
                alone = min(timed, len(scenarios))
                table = run_trials(planners, scenarios, timed=alone, progress=progress)
                taken: dict[str, Any] = {"rounds": count, "own_rounds": own}
                table = table.assign(family=scenarios[0].family, **taken)
                tables.append(table[list(TABLES["ablations"])])
        return pd.concat(tables, ignore_index=True)

    params = {
        "sizes": listed(ground.scenarios),
        "rounds": listed(counts),
        "networks": listed(network.label for network in ground.networks),
    }
    return ground.run(ABLATIONS, params, run, resume=resume, progress=progress)


def _planners(networks: Sequence[EvaluatedNetwork], count: int, own: int) -> list[EvaluatedPlanner]:
    """The refiners and the rule; without a round all of them give the decoupled optima."""
    if count == 0:
        return [EvaluatedPlanner(DECOUPLED_OPTIMUM)]
    if count != own:  # the others are of interest as an answer alone
        networks = [one for one in networks if one.recipe in (TUNED, SHORT)]
    refiners = [
        EvaluatedPlanner(
            replace(one.planner, model=with_rounds(one.predictor, count)),
            one.recipe,
            one.training_seed,
        )
        for one in networks
    ]
    return [*refiners, EvaluatedPlanner(rule(count))]


def dense_beside(ground: HeldOut, count: int) -> list[Scenario]:
    """Test scenarios of the family dense on the data's problem; none if the data has the family."""
    firsts = [some[0] for some in ground.scenarios.values()]
    if any(first.family == DENSE for first in firsts):
        return []  # trials of the same family are told apart by their number alone
    return [draw(DENSE, 0, DENSE_CRAFT, k, firsts[0].problem, "test") for k in range(count)]


def refiners_on(data: Where) -> list[ModelVersion]:
    """The newest refiners of each recipe that were trained on a dataset."""
    found = [version for version in newest_on(data) if version.arch == "refiner"]
    if not found:
        raise InputError(
            f"no refiner was trained on {public_url(data)} as it is now; expected some: "
            "`make ablate` trains one of each recipe, or name some with --models."
        )
    return found


def _common_rounds(networks: Sequence[EvaluatedNetwork]) -> int:
    counts = {network.label: network.predictor.config.get("rounds") for network in networks}
    found = set(counts.values())
    if len(found) == 1 and (own := found.pop()) is not None:
        return own
    known = ", ".join(f"{label} {'none' if k is None else k}" for label, k in counts.items())
    raise InputError(
        f"the models' answers take different numbers of rounds ({known}); expected refiners that "
        "take equally many: name them with --models."
    )


if __name__ == "__main__":
    typer.run(main)
