"""Ablations of the refiner: what it is worth without each of its parts, recorded for the report.

    python -m benchmarks.ablate --data data/paper

Tries the newest refiner of each recipe that was trained on a dataset, and the rule without a
network, on the test split and on swarms of the family dense; tuned, short and the rule after other
numbers of rounds, too. ``prolearn report`` shows the newest run; docs/refiner.md has what came of
one. Recipes are trained by ``prolearn train --arch refiner --recipe short`` and its like.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import pandas as pd
import typer

from cli.app import int_list, name_list
from cli.progress import progress as shown_progress
from cli.stages.entrants import Network, newest_on
from cli.stages.experiment import HeldOut, held_out, listed
from pipeline.errors import InputError
from pipeline.experiments.ablations import SHORT, TUNED
from pipeline.experiments.records import TABLES
from pipeline.experiments.trials import EvaluatedPlanner, run_trials
from pipeline.experiments.verdicts import DECOUPLED
from pipeline.networks.refiner.other_rounds import own_rounds, with_rounds
from pipeline.planners.classical import BASELINES
from pipeline.planners.network import NetworkPlanner
from pipeline.planners.rule import Rule
from pipeline.progress import SILENT, Progress
from pipeline.scenario import Scenario, draw
from pipeline.storage.folder import Where
from pipeline.urls import public_url
from registry.results import Done
from registry.store import ABLATIONS
from registry.version import ModelVersion

DENSE, DENSE_CRAFT = "dense", 10
"""The family that is tried beside the data's, and spacecraft of each such swarm."""

OWN_LP = next(planner for planner in BASELINES if planner.name == DECOUPLED)
"""What any refiner plans without a round."""


@dataclass(frozen=True)
class Asked:
    """Swarm sizes, numbers of rounds, most trials of a size, dense swarms, and timed trials."""

    sizes: Sequence[int] = (10, 30)
    rounds: Sequence[int] = (0, 1, 2, 3, 4, 6, 8, 12, 16, 20, 30)
    trials: int | None = None
    dense: int = 300
    timed: int = 10


def main(
    data: Annotated[str, typer.Option(help="Solved dataset.")] = "data/paper",
    models: Annotated[str | None, typer.Option(help="Refiners; the newest by default.")] = None,
    n: Annotated[str, typer.Option("--n", help="Swarm sizes.")] = "10,30",
    trials: Annotated[int | None, typer.Option(help="Most trials of each size.")] = None,
) -> None:
    """Run all and record it."""
    with shown_progress("ablations") as progress:
        ablate(name_list(models), data, Asked(int_list(n), trials=trials), progress)


def ablate(
    references: Sequence[str], data: Where, asked: Asked, progress: Progress = SILENT
) -> Done:
    """Try refiners of all recipes and the rule alone after other numbers of rounds; record it.

    Raises:
        InputError: for models that are no refiners or whose answers take different numbers of
            rounds, sizes that are not in the dataset, or bad numbers.
    """
    if min(asked.timed, asked.dense, *asked.rounds) < 0:
        raise InputError(f"{asked} has a number below 0; expected 0 or more each.")
    ground = held_out(references, data, asked.sizes, asked.trials, refiners_on)
    tried = [*ground.scenarios.values()]
    if swarms := dense_beside(ground, min(asked.dense, asked.trials or asked.dense)):
        tried.append(swarms)
    own = _common_rounds(ground.networks)
    counts = sorted({0, *asked.rounds, own})
    by_count = {count: _planners(ground.networks, count, own) for count in counts}

    def run(_: object) -> pd.DataFrame:
        progress.expect(len(tried) * sum(map(len, by_count.values())))
        tables = []
        for scenarios in tried:
            for count, planners in by_count.items():
                alone = min(asked.timed, len(scenarios))
                table = run_trials(planners, scenarios, timed=alone, progress=progress)
                taken: dict[str, Any] = {"rounds": count, "own_rounds": own}
                table = table.assign(family=scenarios[0].family, **taken)
                tables.append(table[list(TABLES["ablations"])])
        return pd.concat(tables, ignore_index=True)

    params = {
        "sizes": listed(ground.scenarios),
        "rounds": listed(counts),
        "dense": asked.dense,
        "timed": asked.timed,
        "networks": listed(network.label for network in ground.networks),
    }
    return ground.run(ABLATIONS, params, run, resume=False, progress=progress)


def _planners(networks: Sequence[Network], count: int, own: int) -> list[EvaluatedPlanner]:
    """The refiners and the rule; without a round all of them give the decoupled optima."""
    if count == 0:
        return [EvaluatedPlanner(OWN_LP)]
    rules = [Rule(count), Rule(count, null_space=True)]
    if count != own:  # the others are of interest as an answer alone
        networks, rules = (
            [one for one in networks if one.version.recipe in (TUNED, SHORT)],
            rules[:1],
        )
    refiners = [
        EvaluatedPlanner(
            NetworkPlanner(with_rounds(one.model, count), one.name),
            one.version.recipe,
            one.version.training_seed,
        )
        for one in networks
    ]
    return [*refiners, *map(EvaluatedPlanner, rules)]


def dense_beside(ground: HeldOut, count: int) -> list[Scenario]:
    """Test scenarios of the family dense, on the data's orbit and time grid; none beside such."""
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


def _common_rounds(networks: Sequence[Network]) -> int:
    """The rounds that the answers of all take."""
    counts = {network.label: own_rounds(network.model) for network in networks}
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
