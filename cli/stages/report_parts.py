"""What a report has beside its evaluation: the newest sound run of each other experiment."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import pandas as pd

from cli.stages.run_tables import sound_table
from pipeline.errors import ProlearnError
from pipeline.experiments.records import OPTIMIZERS
from pipeline.markdown import formatted
from pipeline.provenance import version_change
from registry.artifacts import has_digests
from registry.environment import versions_of
from registry.models import list_versions
from registry.results import latest
from registry.runs import Run
from registry.store import ABLATIONS, FLIGHTS, TRANSFER_TIMES, WARMSTART
from registry.version import ModelVersion

FIRST = "Experiments 1 and 2, examples"
"""What the evaluation itself is called."""

DATA = ("dataset_digest",)
SAME = (*DATA, "models")
"""Parameters that a run must share with the evaluation to be in its report."""


@dataclass(frozen=True)
class Part:
    """A run that a report has beside the evaluation.

    Attributes:
        experiment: what it is a run of.
        command: what makes one.
        having: parameters that it must have.
        same: parameters that it must share with the evaluation.
    """

    experiment: str
    command: str
    having: Mapping[str, str] = field(default_factory=dict)
    same: Sequence[str] = SAME


PARTS = {
    **{
        f"Experiment 3, {name}": Part(
            WARMSTART, f"warmstart --optimizer {name}", {"optimizer": name}
        )
        for name in OPTIMIZERS
    },
    "Experiment 4": Part(TRANSFER_TIMES, "transfer-times"),
    # Of the networks, those alone take part whose plans can be made anew on the way.
    "Experiment 5": Part(FLIGHTS, "flights", same=DATA),
    # Refiners that lack something take part in no evaluation.
    "Ablations": Part(ABLATIONS, "ablate", same=DATA),
}
"""By name."""


@dataclass(frozen=True, eq=False)
class Found:
    """A part of a report.

    Attributes:
        run: its run.
        table: a row for each trial.
        others: its models, where they may be others than the evaluation's.
    """

    run: Run
    table: pd.DataFrame
    others: Sequence[ModelVersion]


def find_parts(first: Run) -> tuple[dict[str, Found], list[str]]:
    """The parts of an evaluation's report by name, and why others are left out.

    Raises:
        ProlearnError: where the store fails.
    """
    found, notes = {}, []
    for name, part in PARTS.items():
        same = {name: first.params.get(name, "") for name in part.same}
        run = latest(part.experiment, {**same, **part.having})
        if run is None:
            notes += _of_others(name, part)
            continue
        try:
            others = models_of(run) if part.same == DATA else ()
            found[name] = Found(run, sound_table(run), others)
        except ProlearnError as error:
            notes.append(f"{name} is left out: {error}")
    return found, notes


def models_of(run: Run) -> list[ModelVersion]:
    """The models of a run that are still registered.

    Raises:
        ProlearnError: where the store fails.
    """
    wanted = run.params.get("models", "").split(",")
    return [version for version in list_versions() if version.uri in wanted]


def how_made(first: Run, parts: Mapping[str, Found]) -> list[str]:
    """What a reader must know of how the runs of a report were made."""
    notes = []
    for name, part in parts.items():
        known = versions_of(part.run.tags), versions_of(first.tags)
        change = version_change(*known, "the evaluation with")
        notes += [f"{name} was made with {change}."] if change else []
    runs = {FIRST: first, **{name: part.run for name, part in parts.items()}}
    unchecked = [name for name, run in runs.items() if not has_digests(run)]
    if unchecked:
        notes.append(
            f"{'; '.join(unchecked)}: recorded without checksums, by an earlier version of "
            "prolearn, so that damage to their files since then would not be seen."
        )
    return notes


def day(made: Run | ModelVersion) -> str:
    """When a run or a version was made."""
    return made.created.strftime("%Y-%m-%d %H:%M UTC")


def _of_others(name: str, part: Part) -> list[str]:
    """That there is a run of a part, but of other models or data than the evaluation."""
    other = latest(part.experiment, part.having)
    if other is None:
        return []
    others = "other models or other data" if part.same == SAME else "other data"
    return [
        formatted(
            "{}: the newest run ({}, {}) is of {} than this evaluation, and is left out; "
            "`prolearn {}` makes one.",
            *(name, other.run_id, day(other), others, part.command),
        )
    ]
