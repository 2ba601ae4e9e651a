"""Ablations of the refiner on the test split of a dataset, recorded for the report."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from cli.stages.entrants import Network, newest_on
from cli.stages.experiment import held_out, listed
from pipeline.dataset.storage.folder import Where
from pipeline.errors import InputError
from pipeline.experiments.ablations.run import run_ablations
from pipeline.experiments.answer import FREE
from pipeline.experiments.trials import Entrant
from pipeline.networks.refiner.ablations import REFINER
from pipeline.networks.refiner.other_rounds import own_rounds, with_rounds
from pipeline.planners.baselines import BASELINES
from pipeline.planners.network import Flown
from pipeline.planners.rule import Rule
from pipeline.progress import SILENT, Progress
from registry.results import Done
from registry.store import ABLATIONS
from registry.version import ModelVersion

OWN_LP = next(planner for planner in BASELINES if planner.name == FREE)
"""What any refiner plans without a round."""


def ablate(
    references: Sequence[str],
    data: Where,
    *,
    sizes: Sequence[int],
    rounds: Sequence[int],
    trials: int | None,
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
        timed: scenarios of each size that are timed one at a time.
        resume: leave it where it was done before, with the same data, models and settings.
        progress: told of each planner's trials, and where other versions did it before.

    Raises:
        InputError: for unknown models, models that are no refiners or whose answers take
            different numbers of rounds, sizes that are not in the dataset, or bad numbers.
        ProlearnError: where the store fails.
    """
    if timed < 0 or min(rounds, default=0) < 0:
        raise InputError(f"timed is {timed} and rounds {listed(rounds)}; expected 0 or more each.")
    ground = held_out(references, data, sizes, trials, refiners_on)
    own = _common_rounds(ground.networks)
    counts = sorted({0, *rounds, own})

    def entrants(count: int) -> list[Entrant]:
        """The refiners and the rule; without a round all of them are the own LP."""
        if count == 0:
            return [Entrant(OWN_LP)]
        return [_with_rounds(network, count) for network in ground.networks] + [
            Entrant(Rule(count))
        ]

    def run(_: Path) -> pd.DataFrame:
        progress.expect(len(ground.scenarios) * sum(len(entrants(count)) for count in counts))
        tables = [
            run_ablations(entrants, some, counts, own, timed=timed, progress=progress)
            for some in ground.scenarios.values()
        ]
        return pd.concat(tables, ignore_index=True)

    params = {
        "sizes": listed(ground.scenarios),
        "rounds": listed(counts),
        "timed": timed,
        "networks": listed(network.label for network in ground.networks),
    }
    return ground.run(ABLATIONS, params, run, resume=resume, progress=progress)


def refiners_on(data: Where) -> list[ModelVersion]:
    """The newest refiners of each recipe that were trained on a dataset.

    Raises:
        InputError: where there is none.
    """
    found = [version for version in newest_on(data) if version.arch == REFINER]
    if not found:
        raise InputError(
            f"no refiner was trained on {data} as it is now; expected some: `make ablate` trains "
            "one of each recipe, or name some with --models."
        )
    return found


def _with_rounds(network: Network, count: int) -> Entrant:
    """A refiner that takes so many rounds; its controls are flyable plans as they stand."""
    version, model = network.version, with_rounds(network.model, count)
    return Entrant(Flown(model, network.name), version.recipe, version.training_seed)


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
