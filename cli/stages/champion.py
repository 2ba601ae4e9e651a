"""Who is the champion: two versions of a model on the same validation data, safety first."""

from dataclasses import dataclass

import pandas as pd

from pipeline.dataset.reading import solved_rows
from pipeline.dataset.schema import scenarios_of
from pipeline.errors import InputError
from pipeline.experiments.trials import EvaluatedPlanner, run_trials
from pipeline.experiments.verdicts import compare
from pipeline.networks.model import Model
from pipeline.networks.refiner.ablations import for_comparison
from pipeline.planners.network import NetworkPlanner
from pipeline.storage.folder import Where
from registry.models import champion_of, crown, load, resolve, settle
from registry.version import ModelVersion

MOST = 500
"""Validation scenarios that versions are compared on."""

COLUMNS = ("scenario_id", "n_spacecraft", "family", "initial", "goal")


@dataclass(frozen=True)
class Challenge:
    """What came of holding a version against the champion.

    Attributes:
        champion: who is it now, or None.
        reason: why, in a sentence.
    """

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
        "valid_flown_safe_share": float(trials["safe"].mean()),
        "valid_flown_fuel": float(trials["fuel"].mean()),
        "valid_flown_trials": float(len(trials)),
    }


def challenge(version: ModelVersion, trials: pd.DataFrame, data: Where) -> Challenge:
    """Let a new version take the champion's place where it does better on its validation data.

    Args:
        version: the new one.
        trials: what it does on validation scenarios of the data.
        data: what it was trained on.

    Raises:
        ProlearnError: where the store fails.
    """
    held = _contest(version, trials, data)
    settle(version, held.reason)  # last: where this is missing, ``train --resume`` holds it anew
    return held


def _contest(version: ModelVersion, trials: pd.DataFrame, data: Where) -> Challenge:
    champion = champion_of(version.name)
    if for_comparison(version.arch, version.recipe):
        return Challenge(champion, f"recipe {version.recipe} is there to be compared with")
    if champion is None or champion.version == version.version:
        first = "the first version of its model" if version.version == 1 else "there is no other"
        return Challenge(crown(version), first)
    try:
        model, _ = load(champion)
        held = _held(version, trials, champion, validation_trials(model, data, version.n))
    except InputError as error:
        return Challenge(champion, f"version {champion.version} cannot be compared: {error}")
    return Challenge(crown(version) if held.better else champion, held.reason)


def promote(
    name: str, number: int, data: Where | None = None, *, force: bool = False
) -> tuple[ModelVersion, str]:
    """Make a version the champion of its registered model.

    Args:
        name: the registered model, or its architecture.
        number: of the version.
        data: whose validation split decides; by default what the version was trained on.
        force: also where it does no better than the champion, which is then not looked at.

    Raises:
        InputError: where there is no such version, it does no better than the champion, or there
            is no data to compare them on.
        ProlearnError: where the store fails.
    """
    version = resolve(f"{name}/{number}")
    champion = champion_of(version.name)
    if force or champion is None or champion.version == version.version:
        return crown(version), ""
    where = data or version.params.get("dataset", "")
    try:
        (one, _), (other, _) = load(version), load(champion)
        mine, theirs = (validation_trials(model, where, version.n) for model in (one, other))
        held = _held(version, mine, champion, theirs)
    except InputError as error:
        raise InputError(
            f"{version.label} and the champion, version {champion.version}, cannot be compared "
            f"({error}); expected a dataset that both fit: give --data, or --force."
        ) from error
    if not held.better:
        raise InputError(
            f"{held.reason}; expected a version that does better: give --force to promote it all "
            "the same."
        )
    return crown(version), held.reason


@dataclass(frozen=True)
class _Held:
    """A version held against the champion."""

    better: bool
    reason: str


def _held(
    version: ModelVersion, mine: pd.DataFrame, champion: ModelVersion, theirs: pd.DataFrame
) -> _Held:
    if mine.empty or theirs.empty:
        raise InputError("there are no validation scenarios")
    held = compare(mine, theirs, "fuel")
    ours, others = flown_metrics(mine), flown_metrics(theirs)
    safe, fuel = "valid_flown_safe_share", "valid_flown_fuel"
    reason = (
        f"of {held.trials} validation scenarios {100 * ours[safe]:.1f} % are safe with version "
        f"{version.version} and {100 * others[safe]:.1f} % with version {champion.version}, at "
        f"{ours[fuel]:.3g} and {others[fuel]:.3g} m/s²"
    )
    return _Held(held.better, reason)
