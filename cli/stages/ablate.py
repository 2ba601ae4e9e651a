"""Ablations of the refiner on the test split of a dataset, recorded for the report."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from cli.stages.entrants import Network, newest_on
from cli.stages.experiment import HeldOut, held_out, listed
from pipeline.errors import InputError
from pipeline.experiments.records import TABLES
from pipeline.experiments.trials import EvaluatedPlanner, run_trials
from pipeline.experiments.verdicts import DECOUPLED
from pipeline.networks.refiner.ablations import REFINER, SHORT, TUNED
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


def ablate(
    references: Sequence[str],
    data: Where,
    *,
    sizes: Sequence[int],
    rounds: Sequence[int],
    trials: int | None,
    dense: int,
    timed: int,
    resume: bool = False,
    progress: Progress = SILENT,
) -> Done:
    """Try refiners of all recipes and the rule alone after other numbers of rounds; record it.

    Args:
        references: refiners; none means the newest trainings on the data of each recipe.
        data: a solved dataset.
        sizes: swarm sizes.
        rounds: how many are tried, beside those that the refiners' answers take, and none.
        trials: most scenarios of a size, or all.
        dense: swarms of the family dense that are drawn and tried beside; at most ``trials``, and
            none where the data are of that family.
        timed: scenarios of each size that are timed one at a time.
        resume: leave it where it was done before, with the same data, models and settings.
        progress: told of each planner's trials, and where other versions did it before.

    Raises:
        InputError: for unknown models, models that are no refiners or whose answers take
            different numbers of rounds, sizes that are not in the dataset, or bad numbers.
        ProlearnError: where the store fails.
    """
    if min(timed, dense, *rounds) < 0:
        raise InputError(
            f"timed is {timed}, dense {dense} and rounds {listed(rounds)}; expected 0 or more each."
        )
    ground = held_out(references, data, sizes, trials, refiners_on)
    tried = [*ground.scenarios.values()]
    if swarms := dense_beside(ground, min(dense, trials or dense)):
        tried.append(swarms)
    own = _common_rounds(ground.networks)
    counts = sorted({0, *rounds, own})

    def entrants(count: int) -> list[EvaluatedPlanner]:
        """The refiners and the rule; without a round all of them are the own LP."""
        if count == 0:
            return [EvaluatedPlanner(OWN_LP)]
        if count == own:
            every = [_with_rounds(network, count) for network in ground.networks]
            rules = (Rule(count), Rule(count, null_space=True))
            return [*every, *map(EvaluatedPlanner, rules)]
        # The others are of interest as an answer alone.
        whole = [one for one in ground.networks if one.version.recipe in (TUNED, SHORT)]
        return [*(_with_rounds(network, count) for network in whole), EvaluatedPlanner(Rule(count))]

    def run(_: Path) -> pd.DataFrame:
        progress.expect(len(tried) * sum(len(entrants(count)) for count in counts))
        tables = []
        for scenarios in tried:
            for count in counts:
                alone = min(timed, len(scenarios))
                table = run_trials(entrants(count), scenarios, timed=alone, progress=progress)
                taken: dict[str, Any] = {
                    "family": scenarios[0].family,
                    "rounds": count,
                    "own_rounds": own,
                }
                tables.append(table.assign(**taken)[list(TABLES["ablations"])])
        return pd.concat(tables, ignore_index=True)

    params = {
        "sizes": listed(ground.scenarios),
        "rounds": listed(counts),
        "dense": dense,
        "timed": timed,
        "networks": listed(network.label for network in ground.networks),
    }
    return ground.run(ABLATIONS, params, run, resume=resume, progress=progress)


def dense_beside(ground: HeldOut, count: int) -> list[Scenario]:
    """Test scenarios of the family dense, on the data's orbit and time grid; none beside such."""
    firsts = [some[0] for some in ground.scenarios.values()]
    if any(first.family == DENSE for first in firsts):
        return []  # trials of the same family are told apart by their number alone
    return [draw(DENSE, 0, DENSE_CRAFT, k, firsts[0].problem, "test") for k in range(count)]


def refiners_on(data: Where) -> list[ModelVersion]:
    """The newest refiners of each recipe that were trained on a dataset.

    Raises:
        InputError: where there is none.
    """
    found = [version for version in newest_on(data) if version.arch == REFINER]
    if not found:
        raise InputError(
            f"no refiner was trained on {public_url(data)} as it is now; expected some: "
            "`make ablate` trains one of each recipe, or name some with --models."
        )
    return found


def _with_rounds(network: Network, count: int) -> EvaluatedPlanner:
    """A refiner that takes so many rounds; its controls are flyable plans as they stand."""
    version, model = network.version, with_rounds(network.model, count)
    return EvaluatedPlanner(
        NetworkPlanner(model, network.name), version.recipe, version.training_seed
    )


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
