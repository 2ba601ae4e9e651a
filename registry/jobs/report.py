"""The report, made from the newest results in the tracking store."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

from pipeline.errors import InputError
from pipeline.report import Example, ReportFiles, build_report
from pipeline.report import Results as ReportResults
from registry.models import newest_trainings
from registry.results import Results, fetch_files, latest
from registry.store import EVALUATION, TRANSFER_TIMES, WARMSTART
from registry.tables import training_table


def report(out: Path) -> ReportFiles:
    """Write the report into a folder.

    Raises:
        InputError: where nothing was evaluated yet.
        ProlearnError: where the store fails.
    """
    evaluation = latest(EVALUATION)
    training = training_table(newest_trainings())
    results = ReportResults(
        trials=evaluation.table,
        warmstarts=_table(WARMSTART),
        transfer_times=_table(TRANSFER_TIMES),
        training=training.training,
        curves=training.curves,
        examples=_examples(evaluation),
        facts=_facts(evaluation),
    )
    return build_report(results, out)


def _table(experiment: str) -> pd.DataFrame | None:
    """The newest table of an experiment; a report without it says which command makes it."""
    try:
        return latest(experiment).table
    except InputError:
        return None


def _examples(evaluation: Results) -> list[Example]:
    with TemporaryDirectory(prefix="prolearn-") as scratch:
        folder = fetch_files(evaluation, Path(scratch))
        return [_read_example(path) for path in sorted(folder.glob("*.npz"))]


def _read_example(path: Path) -> Example:
    with np.load(path, allow_pickle=False) as stored:
        tracks = {k.removeprefix("track:"): stored[k] for k in stored.files if ":" in k}
        return Example(
            title=str(stored["name"]),
            initial=stored["initial"],
            goal=stored["goal"],
            tracks=tracks,
            collision_radius=float(stored["collision_radius"]),
        )


def _facts(evaluation: Results) -> dict[str, str]:
    tags = evaluation.tags
    return {
        "Evaluation run": evaluation.run_id,
        "Evaluated": evaluation.created.strftime("%Y-%m-%d %H:%M UTC"),
        "Dataset": evaluation.params.get("data", ""),
        "Dataset digest": evaluation.params.get("dataset_digest", ""),
        "Swarm sizes": evaluation.params.get("sizes", ""),
        "Code": tags.get("git_commit", tags.get("prolearn_version", "")),
        "Machine": f"{tags.get('platform', '').partition('-')[0]}, {tags.get('cores', '')} cores",
        "Python, torch": f"{tags.get('python_version', '')}, {tags.get('torch_version', '')}",
    }
