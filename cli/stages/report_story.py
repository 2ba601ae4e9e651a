"""What a report is made from, before it is put together."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from cli.stages.report_parts import FIRST, Found, day, how_made
from pipeline.experiments.trials import Example
from pipeline.networks.refiner.ablations import for_comparison
from pipeline.report import Results, no_rows
from registry.environment import versions_of
from registry.runs import Run
from registry.store import ABLATIONS, FLIGHTS, TRANSFER_TIMES, WARMSTART
from registry.tables import training_tables
from registry.version import ModelVersion


@dataclass(frozen=True, eq=False)
class Story:
    """An evaluation and what goes with it.

    Attributes:
        first: the evaluation.
        trials: its table.
        examples: transfers to draw.
        versions: the evaluated models.
        parts: runs beside it, by name.
        notes: what a reader must know of what is left out.
    """

    first: Run
    trials: pd.DataFrame
    examples: Sequence[Example]
    versions: Sequence[ModelVersion]
    parts: Mapping[str, Found]
    notes: Sequence[str]


def results_of(story: Story) -> Results:
    """The tables that a report is made from, and what is said of them.

    Raises:
        ProlearnError: where the store fails.
    """
    first, parts, versions = story.first, story.parts, story.versions
    training, curves = training_tables(versions)
    every = _once(versions, *(part.others for part in parts.values()))
    return Results(
        trials=story.trials,
        warmstarts=_joined("warmstarts", parts, WARMSTART),
        transfer_times=_joined("transfer_times", parts, TRANSFER_TIMES),
        flights=_joined("flights", parts, FLIGHTS),
        ablations=_joined("ablations", parts, ABLATIONS),
        training=training,
        curves=curves,
        examples=story.examples,
        provenance=_provenance(first, parts, every),
        notes=[*story.notes, *how_made(first, parts), *_other_models(first, parts)],
    )


def _joined(table: str, parts: Mapping[str, Found], experiment: str) -> pd.DataFrame:
    """A table of Results from the runs of one experiment."""
    found = [part.table for part in parts.values() if part.run.experiment == experiment]
    return pd.concat(found, ignore_index=True) if found else no_rows(table)


def _once(*models: Sequence[ModelVersion]) -> Iterable[ModelVersion]:
    """All models, each once."""
    return {version.uri: version for some in models for version in some}.values()


def _other_models(first: Run, parts: Mapping[str, Found]) -> list[str]:
    """What a reader must know where a part is about other models than the evaluation."""
    evaluated, notes = first.params.get("models", "").split(","), []
    for name, part in parts.items():
        found = [
            version.uri
            for version in part.others
            if version.uri not in evaluated and not for_comparison(version.arch, version.recipe)
        ]
        if found:
            who = ", ".join(found)
            notes.append(f"{name}: {who} took part there and not in this evaluation.")
    return notes


def _provenance(
    first: Run, parts: Mapping[str, Found], versions: Iterable[ModelVersion]
) -> pd.DataFrame:
    """A row for each run that a table of the report comes from."""
    runs = {FIRST: first, **{name: part.run for name, part in parts.items()}}
    rows = [
        _row(name, run, run.params.get("data", ""), run.params.get("dataset_digest", ""))
        for name, run in runs.items()
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
        "made": day(run),
        "data": data,
        "digest": digest,
        "code": tags.get("git_commit", tags.get("prolearn_version", "")),
        "versions": ", ".join(f"{k} {v}" for k, v in sorted(versions_of(tags).items())),
        "machine": f"{tags.get('platform', '').partition('-')[0]}, {tags.get('cores', '')} cores",
    }
