"""Files of runs that were damaged, forged or recorded by an earlier version."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from planted import example, one_size, warm  # noqa: F401
from sentences import Sentences
from typer.testing import CliRunner

from cli.jobs.run_tables import averages
from cli.main import app
from pipeline.errors import InputError, ProlearnError
from pipeline.experiments.example_transfer import read_example, write_example
from pipeline.experiments.records import TABLES
from pipeline.figures.transfer import Example
from registry.results import Run, arrays_of, earlier_run, evaluation, record, table_of
from registry.store import EVALUATION, FLIGHTS, TRANSFER_TIMES, WARMSTART, connect

TRIALS = pd.DataFrame(one_size(10))
PARAMS = {"dataset_digest": "d1", "models": "", "data": "data/paper"}


@pytest.fixture
def run(folder: Path, tmp_path: Path, example: Example) -> str:  # noqa: F811
    """An evaluation, by its id."""
    files = tmp_path / "files"
    files.mkdir()
    write_example(example, files / "example.npz")
    return record(EVALUATION, TRIALS, params=PARAMS, files=files)


@pytest.fixture
def parts(run: str) -> dict[str, str]:
    """Runs beside the evaluation, by the name of their part."""
    warmstarts = pd.DataFrame(warm(10, "converged", "none", [1, 2], [0.1, 0.2], [0.0, 0.0]))
    alone = TRIALS[TRIALS["planner"] == "expert"]
    times = pd.concat([alone.assign(varied=one) for one in ("nodes", "time_step")])
    times = times.assign(nodes=11, time_step=120.0)
    expert = {**PARAMS, "optimizer": "expert"}
    return {
        "Experiment 3, expert": record(WARMSTART, warmstarts, params=expert),
        "Experiment 4": record(TRANSFER_TIMES, times, params=PARAMS),
    }


def artifact(folder: Path, run_id: str, name: str) -> Path:
    (found,) = (folder / "mlruns").glob(f"*/{run_id}/artifacts/*/{name}")
    return found


def forget(run_id: str) -> None:
    """Leave a run as an earlier version recorded it, without digests."""
    client = connect().client
    for tag in client.get_run(run_id).data.tags:
        if tag.startswith("sha256/"):
            client.delete_tag(run_id, tag)


def flips(content: bytes, count: int) -> list[bytes]:
    """The content with one bit flipped, in so many ways."""
    damaged = []
    for bit in np.random.default_rng(0).choice(8 * len(content), count, replace=False):
        copy = bytearray(content)
        copy[bit // 8] ^= 1 << bit % 8
        damaged.append(bytes(copy))
    return damaged


def examples_of(found: Run) -> list[Example]:
    with arrays_of(found) as paths:
        return [read_example(path) for path in paths]


READ = {"table.parquet": table_of, "example.npz": examples_of}
"""What reads a file of a run, by its name."""


@pytest.mark.parametrize("name", READ)
def test_a_flipped_bit_or_a_missing_end_is_found_by_the_digest_that_the_run_has(
    folder: Path, run: str, name: str
) -> None:
    path, found = artifact(folder, run, name), evaluation(run)
    before = table_of(found)
    content = path.read_bytes()
    for damaged in [*flips(content, 10), content[:-1], content[: len(content) // 2], b""]:
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=rf"{name} of run {run} .*SHA-256 .*run the exp"):
            READ[name](found)
    path.write_bytes(content)
    assert len(examples_of(found)) == 1
    pd.testing.assert_frame_equal(table_of(found), before)


@pytest.mark.parametrize("name", READ)
def test_damage_to_a_run_of_an_earlier_version_is_no_more_than_a_sentence(
    folder: Path, run: str, name: str
) -> None:
    forget(run)
    found = evaluation(run)
    assert len(table_of(found)) == len(TRIALS) and len(examples_of(found)) == 1
    path = artifact(folder, run, name)
    content = path.read_bytes()
    refused = 0
    for damaged in [*flips(content, 15), content[:-1], content[: len(content) // 2], b""]:
        path.write_bytes(damaged)
        try:
            READ[name](found)
        except InputError:
            refused += 1
    assert refused > 5


def test_a_missing_file_is_told_with_its_run(folder: Path, run: str) -> None:
    artifact(folder, run, "table.parquet").unlink()
    with pytest.raises(ProlearnError, match=rf"table.parquet of run {run} .*cannot be fetched"):
        table_of(evaluation(run))


def test_a_damaged_run_does_not_count_as_done(folder: Path, run: str) -> None:
    progress = Sentences()
    assert earlier_run(EVALUATION, PARAMS, progress=progress) == run
    artifact(folder, run, "table.parquet").write_bytes(b"")
    assert earlier_run(EVALUATION, PARAMS, progress=progress) is None
    (sentence,) = progress.said
    assert run in sentence and sentence.endswith("It is done again.")


@pytest.mark.parametrize(
    ("table", "told"),
    [
        (TRIALS.drop(columns="fuel"), "no column fuel"),
        (TRIALS.assign(n="ten"), "column n does not hold whole numbers"),
        (TRIALS.assign(n=10.5), "column n does not hold whole numbers"),
        (TRIALS.assign(fuel="much"), "column fuel does not hold numbers"),
        (TRIALS.assign(fuel=True), "column fuel does not hold numbers"),
        (TRIALS.assign(safe=1), "column safe does not hold true or false"),
        (TRIALS.assign(planner=None), "column planner does not hold text"),
        (TRIALS.assign(planner=["a", None] * 7), "column planner does not hold text"),
        (TRIALS.head(0), "no rows"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_table_that_is_none_of_its_experiment_is_refused(
    folder: Path, table: pd.DataFrame, told: str
) -> None:
    run_id = record(EVALUATION, table, params={})
    with pytest.raises(InputError, match=rf"table.parquet of run {run_id} .*\(.*{told}"):
        averages(run_id)


@pytest.mark.parametrize(
    ("experiment", "name", "column"),
    [(TRANSFER_TIMES, "transfer_times", "varied"), (FLIGHTS, "flights", "loop")],
)
def test_a_table_that_lacks_a_column_of_its_experiment_is_refused(
    folder: Path, experiment: str, name: str, column: str
) -> None:
    table = pd.DataFrame([{key: kind(1) for key, kind in TABLES[name].items() if key != column}])
    run_id = record(experiment, table, params={})
    with pytest.raises(InputError, match=f"no column {column}"):
        averages(run_id)


def test_a_planners_earlier_name_is_read_as_its_name(folder: Path) -> None:
    run_id = record(EVALUATION, TRIALS.assign(planner="own LP"), params={})
    assert {row["planner"] for row in averages(run_id)} == {"decoupled optimum"}


def report(*options: str) -> str:
    """What the command says; it ends well, or in one sentence."""
    done = CliRunner().invoke(app, ["report", *options])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.output
    return done.output


def test_a_damaged_part_is_left_out_of_the_report_with_a_note(
    folder: Path, parts: dict[str, str]
) -> None:
    run_id = parts["Experiment 4"]
    path = artifact(folder, run_id, "table.parquet")
    path.write_bytes(path.read_bytes()[:-1])
    assert "The report is" in report()
    text = (folder / "reports" / "report.md").read_text()
    assert text.count(run_id) == 1
    assert f"Experiment 4 is left out: tables/table.parquet of run {run_id}" in text
    assert parts["Experiment 3, expert"][:12] in text
    assert "without checksums" not in text


@pytest.mark.drawn
def test_a_part_with_values_that_make_no_report_is_left_out_with_a_note(
    folder: Path, parts: dict[str, str]
) -> None:
    nonsense = TRIALS.assign(varied="the moon", nodes=-1, time_step=np.inf)
    run_id = record(TRANSFER_TIMES, nonsense, params=PARAMS)
    assert "The report is" in report()
    text = (folder / "reports" / "report.md").read_text()
    assert f"Experiment 4 is left out: tables/table.parquet of run {run_id}" in text
    assert parts["Experiment 3, expert"][:12] in text


@pytest.mark.drawn
@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning:matplotlib")
def test_an_evaluation_with_values_that_make_no_report_is_refused(folder: Path) -> None:
    nonsense = TRIALS.assign(fuel=[1e308, *TRIALS["fuel"][1:]])
    run_id = record(EVALUATION, nonsense, params=PARAMS)
    said = report()
    assert len(said.splitlines()) == 1
    assert f"table.parquet of run {run_id} of prolearn-evaluation cannot be used" in said


def test_a_report_of_a_damaged_evaluation_is_refused(folder: Path, run: str) -> None:
    path = artifact(folder, run, "example.npz")
    path.write_bytes(flips(path.read_bytes(), 1)[0])
    said = report()
    assert len(said.splitlines()) == 1
    assert f"files/example.npz of run {run} of prolearn-evaluation cannot be used" in said


def test_the_report_says_once_which_runs_have_no_checksums(
    folder: Path, run: str, parts: dict[str, str]
) -> None:
    forget(run)
    forget(parts["Experiment 4"])
    report()
    text = (folder / "reports" / "report.md").read_text()
    assert text.count("without checksums") == 1
    assert "Experiments 1 and 2, examples; Experiment 4: recorded without checksums" in text
