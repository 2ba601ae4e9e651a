"""The champion of a model: two versions compared on the same validation data, safety first."""

from dataclasses import dataclass

import pandas as pd

from cli.jobs.held_out import COLUMNS
from pipeline.dataset.reading import solved_rows
from pipeline.dataset.schema import scenarios_of
from pipeline.errors import InputError
from pipeline.experiments.trials import EvaluatedPlanner, run_trials
from pipeline.experiments.verdicts import compare
from pipeline.networks.model import Model
from pipeline.networks.recipes import for_comparison
from pipeline.planners.network import NetworkPlanner
from pipeline.storage.folder import Where
from registry.models import champion_of, load, note_contest, resolve, set_champion
from registry.version import ModelVersion

MOST = 500
"""Validation scenarios that versions are compared on."""

SAFE_SHARE, FUEL = "valid_flown_safe_share", "valid_flown_fuel"
"""Metrics of a training run."""


@dataclass(frozen=True)
class Contest:
    """The outcome of comparing a version with the champion: who is it now, and why."""

    champion: ModelVersion | None
    reason: str


def validation_trials(model: Model, data: Where, n: int) -> pd.DataFrame:
    """A network, flown, on validation scenarios: a row each, columns of Trial.

    Raises:
        InputError: where the data has none of this size, or the weights do not fit it.
    """
    scenarios = scenarios_of(solved_rows(data, n, "valid", COLUMNS))[:MOST]
    flown = NetworkPlanner(model, model.architecture)
    return run_trials([EvaluatedPlanner(flown)], scenarios) if scenarios else pd.DataFrame()


def flown_metrics(trials: pd.DataFrame) -> dict[str, float]:
    """Metrics of a training run by which one of several networks can be picked."""
    if trials.empty:
        return {}
    return {
        SAFE_SHARE: float(trials["safe"].mean()),
        FUEL: float(trials["fuel"].mean()),
        "valid_flown_trials": float(len(trials)),
    }


def challenge(version: ModelVersion, trials: pd.DataFrame, data: Where) -> Contest:
    """Make a new version the champion where it does better on its validation data."""
    contest = _contest(version, trials, data)
    # Last: where this is missing, ``train --resume`` compares once more.
    note_contest(version, contest.reason)
    return contest


def _contest(version: ModelVersion, trials: pd.DataFrame, data: Where) -> Contest:
    champion = champion_of(version.name)
    if for_comparison(version.arch, version.recipe):
        return Contest(champion, f"recipe {version.recipe} is there to be compared with")
    if champion is None or champion.version == version.version:
        first = "the first version of its model" if version.version == 1 else "there is no other"
        return Contest(set_champion(version), first)
    try:
        model, _ = load(champion)
        theirs = validation_trials(model, data, version.n)
        better, reason = _compared(version, trials, champion, theirs)
    except InputError as error:
        return Contest(champion, f"version {champion.version} cannot be compared: {error}")
    return Contest(set_champion(version) if better else champion, reason)


def promote(
    name: str, number: int, data: Where | None = None, *, force: bool = False
) -> tuple[ModelVersion, str]:
    """Make a version the champion of its registered model; the champion now, and why.

    The validation split of the data decides, by default of what the version was trained on;
    with ``force`` nothing is compared.

    Raises:
        InputError: where there is no such version, it does no better than the champion, or there
            is no data to compare them on.
    """
    version = resolve(f"{name}/{number}")
    champion = champion_of(version.name)
    if force or champion is None or champion.version == version.version:
        return set_champion(version), ""
    where = data or version.params.get("dataset", "")
    try:
        (one, _), (other, _) = load(version), load(champion)
        mine, theirs = (validation_trials(model, where, version.n) for model in (one, other))
        better, reason = _compared(version, mine, champion, theirs)
    except InputError as error:
        raise InputError(
            f"{version.label} and the champion, version {champion.version}, cannot be compared "
            f"({error}); expected a dataset that both fit: give --data, or --force."
        ) from error
    if not better:
        raise InputError(
            f"{reason}; expected a version that does better: give --force to promote it all "
            "the same."
        )
    return set_champion(version), reason


def _compared(
    version: ModelVersion, mine: pd.DataFrame, champion: ModelVersion, theirs: pd.DataFrame
) -> tuple[bool, str]:
    """Whether a version is better than the champion, and the figures in words."""
    if mine.empty or theirs.empty:
        raise InputError("there are no validation scenarios")
    compared = compare(mine, theirs, "fuel")
    ours, others = flown_metrics(mine), flown_metrics(theirs)
    return compared.better, (
        f"of {compared.trials} validation scenarios {100 * ours[SAFE_SHARE]:.1f} % are safe with "
        f"version {version.version} and {100 * others[SAFE_SHARE]:.1f} % with version "
        f"{champion.version}, at {ours[FUEL]:.3g} and {others[FUEL]:.3g} m/s²"
    )
