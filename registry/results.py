"""Runs of experiments in MLflow, with checksums of their files: recorded, found, read, resumed."""

import json
import platform
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import Any

import mlflow
import pandas as pd

from pipeline.errors import InputError, ProlearnError
from pipeline.experiments.parts import FinishedParts, open_parts
from pipeline.progress import SILENT, Progress
from pipeline.provenance import DecidedBy, made_with
from pipeline.scratch import scratch_folder
from pipeline.storage.folder import open_folder
from pipeline.storage.shards import digest_of, table_bytes, table_from
from registry import entities
from registry.environment import EVALUATED_BY, changed_since, environment_tags
from registry.store import EVALUATION, Store, connect, opened, recorded_run

KIND = "optimizer"  # the parameter that tells kinds of an experiment's runs apart, if they have it
LISTED = 5  # most runs that an error message names
SEQUENCE = "sequence"  # tag with a run's number in its experiment, from 1, with leading zeros
DIGITS = 9
LAST = 10**DIGITS - 1  # greatest number there is; runs that share one are ordered by their clocks
AT_ONCE = 20  # runs that are asked for at once; the newest are wanted most
TABLE = "tables/table.parquet"  # a run's table, among its artifacts
FILES = "files"  # the folder there of what goes with the table
UNFINISHED = "mlruns/.unfinished"  # beside the store: parts of runs that are not finished
KEY_DIGITS = 32  # hexadecimal digits of what decides the parts, in the name of their folder
DIGEST = "sha256/"  # prefix of the tags that hold the SHA-256 of the file whose name follows

_ARRAYS = re.compile(rf"{FILES}/[\w. -]+\.npz")


@dataclass(frozen=True)
class Run:
    """A finished run of an experiment, without its files; tags say what it was made with."""

    experiment: str
    run_id: str
    created: datetime
    params: Mapping[str, str]
    tags: Mapping[str, str]

    @property
    def has_digests(self) -> bool:
        """Whether it has checksums of its files; runs of earlier versions have none."""
        return DIGEST + TABLE in self.tags


@dataclass(frozen=True)
class Recorded:
    """The MLflow run with an experiment's results, and whether it was there before."""

    run_id: str
    earlier: bool = False


def record(
    experiment: str,
    table: pd.DataFrame,
    made_by: DecidedBy = EVALUATED_BY,
    *,
    params: Mapping[str, Any],
    files: Path | None = None,
    dataset: tuple[str, str] | None = None,
) -> str:
    """Record the results of an experiment, a table with a row for each trial; the run's id.

    The content of the folder ``files`` goes with it; the dataset is folder and digest of that
    whose test split was used. ``made_by`` is the code that decides the results.
    """
    content = {TABLE: table_bytes(table)}
    for path in files.glob("*.npz") if files else ():
        content[f"{FILES}/{path.name}"] = path.read_bytes()
    digests = {DIGEST + name: digest_of(some) for name, some in content.items()}
    tags = {**environment_tags(made_by), **digests}
    with opened() as store, scratch_folder() as scratch:
        (scratch / TABLE).parent.mkdir()
        (scratch / TABLE).write_bytes(content[TABLE])
        tags[SEQUENCE] = _next_number(store, experiment)
        kind = [str(params[KIND])] if KIND in params else []
        name = "-".join([experiment.removeprefix("prolearn-"), *kind])
        with recorded_run(store, experiment, name, tags) as run_id:
            store.client.log_batch(run_id, params=entities.params_of(params))
            if dataset is not None:
                used = entities.dataset_input(*dataset, entities.EVALUATION_DATA)
                store.client.log_inputs(run_id, [used])
            store.client.log_artifacts(run_id, str(scratch))
            if files is not None:
                store.client.log_artifacts(run_id, str(files), FILES)
            return run_id


def earlier_run(
    experiment: str,
    params: Mapping[str, Any],
    progress: Progress = SILENT,
    made_by: DecidedBy = EVALUATED_BY,
) -> str | None:
    """The newest finished run of its kind, where it had these parameters and versions."""
    wanted = entities.recorded(params)
    run = latest(experiment, {KIND: wanted[KIND]} if KIND in wanted else {})
    if run is None or deciding(run.params) != deciding(wanted):
        return None
    if change := changed_since(run.tags, made_by):
        progress.say(f"run {run.run_id} of {experiment} was made with {change}; it is done again.")
        return None
    try:
        table_of(run)
        with arrays_of(run):
            return run.run_id
    except InputError as error:
        progress.say(f"{error} It is done again.")
        return None


def deciding(params: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters that determine results: all but the dataset's path, since its digest is one."""
    return {name: value for name, value in params.items() if name != "data"}


def latest(
    experiment: str,
    having: Mapping[str, str] | None = None,
    fits: Callable[[Run], bool] = lambda _: True,
) -> Run | None:
    """Newest finished run of an experiment with given parameters that ``fits`` accepts, or None."""
    with opened(create=False) as store:
        return next(filter(fits, _finished(store, experiment, having)), None)


def evaluation(run_id: str | None = None) -> Run:
    """An evaluation: the newest, or the one of a run; InputError where there is none."""
    if found := latest(EVALUATION, fits=lambda run: run_id in (None, run.run_id)):
        return found
    if run_id is None:
        raise InputError(
            f"there is no finished {EVALUATION}; expected one: run `prolearn evaluate` first."
        )
    with opened(create=False) as store:
        known = [run.run_id for run in islice(_finished(store, EVALUATION), LISTED)]
    raise InputError(
        f"There is no finished evaluation {run_id!r}; expected the run of one, newest first: "
        f"{', '.join(known) or 'none'}."
    )


def experiment_run(run_id: str) -> Run:
    """The run of an experiment, by its id."""
    with opened(create=False) as store:
        return _run_of(store, store.client.get_run(run_id))


def table_of(run: Run) -> pd.DataFrame:
    """A run's table: a row for each trial; InputError where it is damaged, none, or too large."""
    with opened(create=False) as store, scratch_folder() as scratch:
        content = _fetched(store, run, TABLE, scratch).read_bytes()
    try:
        return table_from(content)
    except InputError as error:
        raise unusable_file(run, TABLE, error) from error


@contextmanager
def arrays_of(run: Run) -> Iterator[list[Path]]:
    """The files of a run that hold arrays, for the block; InputError where one is damaged."""
    with scratch_folder() as scratch:
        with opened(create=False) as store:
            if run.has_digests:
                names = [tag.removeprefix(DIGEST) for tag in run.tags if tag.startswith(DIGEST)]
            else:
                names = [found.path for found in store.client.list_artifacts(run.run_id, FILES)]
            names = sorted(name for name in names if _ARRAYS.fullmatch(name))
            paths = [_fetched(store, run, name, scratch) for name in names]
        yield paths


def unusable_file(run: Run, name: str, why: object) -> InputError:
    """The error for a file of a run that cannot be used."""
    return InputError(
        f"{name} of run {run.run_id} of {run.experiment} cannot be used ({why}); restore the file, "
        "or run the experiment again."
    )


def _fetched(store: Store, run: Run, name: str, scratch: Path) -> Path:
    place = {"run_id": run.run_id, "artifact_path": name, "dst_path": str(scratch)}
    try:
        path = Path(mlflow.artifacts.download_artifacts(**place, tracking_uri=store.uri))
        digest = digest_of(path.read_bytes())
    except Exception as error:  # of any kind: where files are, each cloud's library has its own
        raise ProlearnError(
            f"{name} of run {run.run_id} of {run.experiment} cannot be fetched ({error}); restore "
            "it, or run the experiment again; where the project was moved, see docs/mlflow.md."
        ) from error
    if digest != run.tags.get(DIGEST + name, digest):
        raise unusable_file(run, name, "its SHA-256 is not the recorded one")
    return path


def _finished(
    store: Store, experiment: str, having: Mapping[str, str] | None = None
) -> Iterator[Run]:
    """Finished runs with given parameters, newest first; runs without a number come last."""
    wanted, others = (having or {}).items(), []
    for found in _runs(store, experiment, filter_string="attributes.status = 'FINISHED'"):
        run = _run_of(store, found)
        if wanted <= run.params.items():
            if _number(found):
                yield run
            else:
                others.append(run)
    yield from sorted(others, key=lambda run: run.created, reverse=True)


def _next_number(store: Store, experiment: str) -> str:
    """One more than the greatest number of the runs that are finished or being written."""
    counted = ("FINISHED", "RUNNING")
    numbers = (_number(r) for r in _runs(store, experiment) if r.info.status in counted)
    return f"{min(next(filter(None, numbers), 0) + 1, LAST):0{DIGITS}}"


def _run_of(store: Store, run: Any) -> Run:
    names = {number: name for name, number in store.experiments.items()}
    return Run(
        experiment=names[run.info.experiment_id],
        run_id=run.info.run_id,
        created=entities.utc_time(run.info.start_time),
        params=entities.recorded(run.data.params),
        tags=entities.own_tags(run.data.tags),
    )


def _runs(store: Store, experiment: str, **query: Any) -> Iterator[Any]:
    """MLflow's runs, those with a number in descending order; others may be anywhere."""
    return entities.pages(
        store.client.search_runs,
        experiment_ids=[store.experiments[experiment]],
        order_by=[f"tags.`{SEQUENCE}` DESC", "attributes.start_time DESC"],
        max_results=AT_ONCE,
        **query,
    )


def _number(run: Any) -> int:
    text = run.data.tags.get(SEQUENCE, "")
    return int(text) if re.fullmatch(f"[0-9]{{{DIGITS}}}", text) else 0


@contextmanager
def unfinished_parts(
    experiment: str,
    decided_by: Mapping[str, Any],
    made_by: DecidedBy,
    *,
    resume: bool,
    progress: Progress = SILENT,
) -> Iterator[FinishedParts]:
    """Finished parts of an unfinished experiment, removed once the block ends without an error.

    With ``resume`` those of an earlier run are used where settings, versions and machine are the
    same; else they are removed. InputError where another process is doing the same.
    """
    settings = {**decided_by, "made_with": made_with(*made_by), "machine": platform.node()}
    text = json.dumps(settings, sort_keys=True, default=str).encode()
    place = connect().folder / UNFINISHED / f"{experiment}-{digest_of(text)[:KEY_DIGITS]}"
    with open_parts(open_folder(place), made_by, resume=resume, progress=progress) as parts:
        yield parts
    shutil.rmtree(place, ignore_errors=True)
    with suppress(OSError):  # where other experiments are under way
        place.parent.rmdir()
