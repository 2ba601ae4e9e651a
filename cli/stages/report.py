"""The report of one evaluation, with what else is of the same models on the same data."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cli.stages.report_parts import find_parts, models_of
from cli.stages.report_story import Story, results_of
from cli.stages.run_tables import sound_table
from pipeline.errors import InputError, ProlearnError
from pipeline.experiments.trials import Example, read_example
from pipeline.report import ReportFiles, build_report
from pipeline.scratch import scratch_folder
from registry.artifacts import FILES, TABLE, unusable
from registry.results import arrays_of, evaluation
from registry.runs import Run
from registry.version import ModelVersion


def report(out: Path, run_id: str | None = None) -> ReportFiles:
    """Write the report of an evaluation into a folder.

    Args:
        out: the folder.
        run_id: the evaluation's run; the newest by default.

    Raises:
        InputError: where nothing was evaluated yet, there is no such run, or it is damaged.
        ProlearnError: where the store fails.
    """
    first = evaluation(run_id)
    trials, examples, versions = sound_table(first), _examples(first), models_of(first)
    parts, notes = find_parts(first)
    story = Story(first, trials, examples, versions, parts, [*notes, *_gone(first, versions)])
    try:
        return build_report(results_of(story), out)
    except ProlearnError:
        raise
    except Exception:  # of any kind: anyone may have written any values into a shared store
        logging.getLogger("prolearn").debug("the report cannot be made of all", exc_info=True)
        return build_report(results_of(_without_nonsense(story)), out)


def _without_nonsense(story: Story) -> Story:
    """The story without the parts and models of whose values no report can be made.

    Raises:
        InputError: where none can be made of the evaluation.
    """
    bare = replace(story, versions=(), parts={})
    if fault := _fault(bare):
        raise unusable(story.first, TABLE, f"no report can be made of its values: {fault}")
    notes, parts, versions = [*story.notes], {}, []
    for name, part in story.parts.items():
        if fault := _fault(replace(bare, parts={name: part})):
            notes.append(f"{name} is left out: {unusable(part.run, TABLE, fault)}")
        else:
            parts[name] = part
    for version in story.versions:
        if fault := _fault(replace(bare, versions=[version])):
            notes.append(f"The training of {version.uri} is left out: its values give {fault}.")
        else:
            versions.append(version)
    return replace(story, notes=notes, parts=parts, versions=versions)


def _fault(story: Story) -> str:
    """What goes wrong in making the report of a story; nothing where all goes well."""
    with scratch_folder() as folder:
        try:
            build_report(results_of(story), folder)
        except Exception as error:
            return repr(error)[:200]
    return ""


def _gone(first: Run, versions: Sequence[ModelVersion]) -> list[str]:
    """What a reader must know where evaluated models are no longer there."""
    gone = len(set(filter(None, first.params.get("models", "").split(",")))) - len(versions)
    return [f"Training: {gone} of the evaluated models are no longer there."] if gone else []


def _examples(first: Run) -> list[Example]:
    with arrays_of(first) as paths:
        return [_example(first, path) for path in paths]


def _example(first: Run, path: Path) -> Example:
    try:
        return read_example(path)
    except InputError as error:
        raise unusable(first, f"{FILES}/{path.name}", error) from error
