"""The report of one evaluation, with what else is of the same models on the same data."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from pipeline.experiments.examples.run import Example, read_example
from pipeline.experiments.experiment3.rows import OPTIMIZERS
from pipeline.networks.refiner.ablations import for_comparison
from pipeline.provenance import version_change
from pipeline.report import ReportFiles, Results, build_report, no_rows
from pipeline.scratch import scratch_folder
from registry.environment import versions_of
from registry.models import list_versions
from registry.results import evaluation, fetch_files, latest, table_of
from registry.runs import Run
from registry.store import ABLATIONS, FLIGHTS, TRANSFER_TIMES, WARMSTART
from registry.tables import training_tables
from registry.version import ModelVersion

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

OTHERS = [name for name, part in PARTS.items() if part.same == DATA]
"""Those that may have other models than the evaluation."""


def report(out: Path, run_id: str | None = None) -> ReportFiles:
    """Write the report of an evaluation into a folder.

    Args:
        out: the folder.
        run_id: the evaluation's run; the newest by default.

    Raises:
        InputError: where nothing was evaluated yet, or there is no such run.
        ProlearnError: where the store fails.
    """
    first = evaluation(run_id)
    parts = {name: _run_of(part, first) for name, part in PARTS.items()}
    versions, others = _models(first), {name: _models(parts[name]) for name in OTHERS}
    training, curves = training_tables(versions)
    results = Results(
        trials=table_of(first),
        warmstarts=_joined("warmstarts", parts, WARMSTART),
        transfer_times=_joined("transfer_times", parts, TRANSFER_TIMES),
        flights=_joined("flights", parts, FLIGHTS),
        ablations=_joined("ablations", parts, ABLATIONS),
        training=training,
        curves=curves,
        examples=_examples(first),
        provenance=_provenance(first, parts, _once(versions, *others.values())),
        notes=_notes(first, parts, versions) + _other_models(versions, others),
    )
    return build_report(results, out)


def _run_of(part: Part, first: Run) -> Run | None:
    """The newest run that goes with an evaluation."""
    same = {name: first.params.get(name, "") for name in part.same}
    return latest(part.experiment, {**same, **part.having})


def _models(run: Run | None) -> list[ModelVersion]:
    """The models of a run that are still registered."""
    wanted = run.params.get("models", "").split(",") if run else []
    return [version for version in list_versions() if version.uri in wanted]


def _joined(table: str, parts: Mapping[str, Run | None], experiment: str) -> pd.DataFrame:
    """A table of Results from the runs of one experiment."""
    found = [table_of(run) for name, run in parts.items() if run and run.experiment == experiment]
    return pd.concat(found, ignore_index=True) if found else no_rows(table)


def _notes(
    first: Run, parts: Mapping[str, Run | None], versions: Sequence[ModelVersion]
) -> list[str]:
    """What a reader must know of parts that are left out or made with other versions."""
    notes = []
    for name, part in parts.items():
        known = PARTS[name]
        if part is None and (other := latest(known.experiment, known.having)) is not None:
            others = "other models or other data" if known.same == SAME else "other data"
            notes.append(
                f"{name}: the newest run ({other.run_id}, {_day(other)}) is of {others} than this "
                f"evaluation, and is left out; `prolearn {known.command}` makes one."
            )
        if part is not None:
            versions_differ = version_change(
                versions_of(part.tags), versions_of(first.tags), "the evaluation with"
            )
            notes += [f"{name} was made with {versions_differ}."] if versions_differ else []
    gone = len(set(filter(None, first.params.get("models", "").split(",")))) - len(versions)
    if gone:
        notes.append(f"Training: {gone} of the evaluated models are no longer registered.")
    return notes


def _once(*models: Sequence[ModelVersion]) -> Iterable[ModelVersion]:
    """All models, each once."""
    return {version.uri: version for some in models for version in some}.values()


def _other_models(
    versions: Sequence[ModelVersion], others: Mapping[str, Sequence[ModelVersion]]
) -> list[str]:
    """What a reader must know where a part is about other models than the evaluation."""
    evaluated, notes = {version.uri for version in versions}, []
    for name, there in others.items():
        found = [
            version.uri
            for version in there
            if version.uri not in evaluated and not for_comparison(version.arch, version.recipe)
        ]
        if found:
            who = ", ".join(found)
            notes.append(f"{name}: {who} took part there and not in this evaluation.")
    return notes


def _provenance(
    first: Run, parts: Mapping[str, Run | None], versions: Iterable[ModelVersion]
) -> pd.DataFrame:
    """A row for each run that a table of the report comes from."""
    runs = {"Experiments 1 and 2, examples": first, **parts}
    rows = [
        _row(name, run, run.params.get("data", ""), run.params.get("dataset_digest", ""))
        for name, run in runs.items()
        if run is not None
    ]
    rows += [
        _row(
            f"Training {v.label}, seed {v.training_seed}",
            v,
            v.params.get("dataset", ""),
            v.dataset_digest,
        )
        for v in versions
    ]
    return pd.DataFrame(rows)


def _row(part: str, run: Run | ModelVersion, data: str, digest: str) -> dict[str, str]:
    tags = run.tags
    return {
        "part": part,
        "run": run.run_id,
        "made": _day(run),
        "data": data,
        "digest": digest,
        "code": tags.get("git_commit", tags.get("prolearn_version", "")),
        "versions": ", ".join(f"{k} {v}" for k, v in sorted(versions_of(tags).items())),
        "machine": f"{tags.get('platform', '').partition('-')[0]}, {tags.get('cores', '')} cores",
    }


def _day(run: Run | ModelVersion) -> str:
    return run.created.strftime("%Y-%m-%d %H:%M UTC")


def _examples(first: Run) -> list[Example]:
    with scratch_folder() as scratch:
        folder = fetch_files(first, scratch)
        return [read_example(path) for path in sorted(folder.glob("*.npz"))]
