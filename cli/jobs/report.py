"""The report of one evaluation, with the newest sound run of each other experiment beside it."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import pandas as pd

from cli.jobs.run_tables import KINDS, sound_table
from pipeline.errors import InputError, ProlearnError
from pipeline.experiments.example_transfer import read_example
from pipeline.experiments.records import OPTIMIZERS
from pipeline.figures.transfer import Example
from pipeline.files import refuse_unwritable
from pipeline.markup import formatted
from pipeline.provenance import version_change
from pipeline.report import ReportFiles, Results, build_report
from pipeline.scratch import scratch_folder
from registry.environment import versions_of
from registry.metrics import training_tables
from registry.models import ModelVersion, list_versions
from registry.results import FILES, TABLE, Run, arrays_of, evaluation, latest, unusable_file
from registry.store import FLIGHTS, TRANSFER_TIMES, WARMSTART

EVALUATED = "Experiments 1 and 2, examples"  # name of the evaluation among a report's parts
DATA = ("dataset_digest",)
SHARED = (*DATA, "models")  # parameters that other runs must share with the evaluation


@dataclass(frozen=True)
class ReportPart:
    """A run that a report has beside the evaluation."""

    experiment: str
    command: str  # that makes such a run
    params: Mapping[str, str] = field(default_factory=dict)  # parameters that it must have
    shared: Sequence[str] = SHARED  # parameters that it must share with the evaluation


PARTS = {  # by name
    **{
        f"Experiment 3, {name}": ReportPart(
            WARMSTART, f"prolearn warmstart --optimizer {name}", {"optimizer": name}
        )
        for name in OPTIMIZERS
    },
    "Experiment 4": ReportPart(TRANSFER_TIMES, "prolearn transfer-times"),
    # Only networks that can replan on the way take part.
    "Experiment 5": ReportPart(FLIGHTS, "prolearn flights", shared=DATA),
}


@dataclass(frozen=True, eq=False)
class ReportedRun:
    """A run that is in the report, with its table and the models that are still registered."""

    run: Run
    table: pd.DataFrame
    models: Sequence[ModelVersion]


def report(out: Path, run_id: str | None = None) -> ReportFiles:
    """Write the report of an evaluation, by default the newest; InputError without a sound one.

    InputError also for a URL; InputError or OSError where the folder cannot be written to.
    """
    if any(out.glob("loop=*")):
        raise InputError(f"{out} is a folder of trials; expected another: give it with --out.")
    refuse_unwritable(out / "report.md")  # before all is read and drawn
    run = evaluation(run_id)
    first = ReportedRun(run, sound_table(run), _models_of(run))
    with arrays_of(run) as paths:
        examples = [_example(run, path) for path in paths]
    others, notes = _other_parts(run)
    parts = {EVALUATED: first, **others}
    if gone := len(set(_model_names(run))) - len(first.models):
        notes.append(f"Training: evaluated models that are no longer there: {gone}.")
    try:
        return build_report(_results(parts, examples, notes), out)
    except (ProlearnError, OSError):  # of the store, or the disk
        raise
    except Exception:  # of any kind: anyone may have written any values into a shared store
        logging.getLogger("prolearn").debug("the report cannot be made of all", exc_info=True)
        parts, left_out = _without_faulty(parts, examples)
        return build_report(_results(parts, examples, [*notes, *left_out]), out)


def _example(run: Run, path: Path) -> Example:
    try:
        return read_example(path)
    except InputError as error:
        raise unusable_file(run, f"{FILES}/{path.name}", error) from error


def _other_parts(first: Run) -> tuple[dict[str, ReportedRun], list[str]]:
    """The parts of an evaluation's report by name, and why others are left out."""
    found, notes = {}, []
    for name, part in PARTS.items():
        same = {name: first.params.get(name, "") for name in part.shared}
        run = latest(part.experiment, {**same, **part.params}, partial(_same_weights, first))
        if run:
            try:
                # Other parts have the evaluation's models.
                models = _models_of(run) if part.shared == DATA else ()
                found[name] = ReportedRun(run, sound_table(run), models)
            except ProlearnError as error:
                notes.append(f"{name} is left out: {error}")
        elif other := latest(part.experiment, part.params):
            others, options = "other data", "--data"
            if part.shared == SHARED or not _same_weights(first, other):
                others, options = "other models or other data", "--data and --models"
            text = (
                "{}: the newest run ({}, {}) is of {} than this evaluation, and is left out; `{}` "
                "with {} of this evaluation makes one."
            )
            values = (name, other.run_id, _day(other), others, part.command, options)
            notes.append(formatted(text, *values))
    return found, notes


def _model_names(run: Run) -> list[str]:
    return [name for name in run.params.get("models", "").split(",") if name]


def _weights(run: Run) -> dict[str, str]:
    """The first digits of each model's weight digest by URI; none in runs of earlier versions."""
    digests = filter(None, run.params.get("weights", "").split(","))
    return dict(zip(_model_names(run), digests, strict=False))


def _same_weights(first: Run, other: Run) -> bool:
    """Whether no model URI has different weights in both runs, as after a deletion."""
    known = _weights(first)
    return all(known.get(uri, digest) == digest for uri, digest in _weights(other).items())


def _models_of(run: Run) -> list[ModelVersion]:
    """Registered versions of the models that a run evaluated, with the weights that they had."""
    wanted, known = _model_names(run), _weights(run)
    versions = [version for version in list_versions() if version.uri in wanted]
    return [v for v in versions if not v.weights or v.weights.startswith(known.get(v.uri, ""))]


def _without_faulty(
    parts: Mapping[str, ReportedRun], examples: Sequence[Example]
) -> tuple[dict[str, ReportedRun], list[str]]:
    """Parts and models of which a report can be made, and notes on the others."""

    def fault(others: Mapping[str, ReportedRun], models: Sequence[ModelVersion] = ()) -> str:
        """The error of a report of some parts and models; empty where it can be made."""
        tried = {EVALUATED: replace(first, models=models), **others}
        with scratch_folder() as folder:
            try:
                build_report(_results(tried, examples, ()), folder)
            except OSError:
                raise
            except Exception as error:
                return repr(error)[:200]
        return ""

    first, models, sound, notes = parts[EVALUATED], [], {}, []
    if found := fault({}):
        raise unusable_file(first.run, TABLE, f"no report can be made of its values: {found}")
    for name, part in parts.items():
        if name == EVALUATED:
            continue
        if found := fault({name: part}):
            notes.append(f"{name} is left out: {unusable_file(part.run, TABLE, found)}")
        else:
            sound[name] = part
    for version in first.models:
        if found := fault({}, [version]):
            notes.append(f"The training of {version.uri} is left out: its values give {found}.")
        else:
            models.append(version)
    return {EVALUATED: replace(first, models=models), **sound}, notes


def _results(
    parts: Mapping[str, ReportedRun], examples: Sequence[Example], notes: Sequence[str]
) -> Results:
    first = parts[EVALUATED]
    there = set(first.table["planner"])  # with the names of then, though models may have gone since
    names = {v.uri: v.numbered if v.numbered in there else v.arch for v in first.models}
    training, curves = training_tables(first.models, names)
    tables: dict[str, list[pd.DataFrame]] = {}
    for part in parts.values():
        name, _ = KINDS[part.run.experiment]
        tables.setdefault(name, []).append(part.table)
    return Results(
        **{name: pd.concat(some, ignore_index=True) for name, some in tables.items()},
        training=training,
        curves=curves,
        examples=examples,
        provenance=_provenance(parts),
        notes=[*notes, *_notes(parts)],
    )


def _notes(parts: Mapping[str, ReportedRun]) -> Iterator[str]:
    """Notes on parts of other versions than the evaluation, without checksums, of other models."""
    first = parts[EVALUATED].run
    for name, part in parts.items():
        was, now = versions_of(part.run.tags), versions_of(first.tags)
        # An architecture that others bring decides nothing where it has no part.
        absent = {name for name in was.keys() ^ now.keys() if ":" in name}
        was, now = ({k: one[k] for k in one.keys() - absent} for one in (was, now))
        if change := version_change(was, now, "the evaluation with"):
            yield f"{name} was made with {change}."
    if unchecked := [name for name, part in parts.items() if not part.run.has_digests]:
        yield (
            f"{'; '.join(unchecked)}: recorded without checksums, by an earlier version of "
            "prolearn, so that damage to their files since then would not be seen."
        )
    evaluated = _model_names(first)
    for name, part in parts.items():
        if others := [one.uri for one in part.models if one.uri not in evaluated]:
            yield f"{name}: {', '.join(others)} took part there and not in this evaluation."


def _provenance(parts: Mapping[str, ReportedRun]) -> pd.DataFrame:
    rows = [_provenance_row(name, part.run) for name, part in parts.items()]
    trained = {v.uri: v for part in parts.values() for v in part.models}.values()
    rows += [_provenance_row(f"Training {v.label}, seed {v.training_seed}", v) for v in trained]
    return pd.DataFrame(rows)


def _provenance_row(part: str, run: Run | ModelVersion) -> dict[str, str]:
    params, tags = run.params, run.tags
    if isinstance(run, Run):
        data, digest = params.get("data", ""), params.get("dataset_digest", "")
    else:
        data, digest = params.get("dataset", ""), run.dataset_digest
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


def _day(made: Run | ModelVersion) -> str:
    return made.created.strftime("%Y-%m-%d %H:%M UTC")
