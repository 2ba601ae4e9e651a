"""What any writer of a shared store may leave in it: nothing of it breaks a command for the others.

The nonsense goes straight into the database, past what MLflow would refuse.
"""

import logging
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from forked import Forked
from noisy import network
from planted import one_size
from typer.testing import CliRunner

from cli.jobs.experiments import networks
from cli.jobs.train import challenge
from cli.jobs.training import validation_trials
from cli.main import app
from pipeline.dataset.manifest import read_manifest
from pipeline.errors import InputError
from pipeline.experiments.example_transfer import write_example
from pipeline.figures.transfer import Example
from pipeline.networks.architecture import recipe_for
from pipeline.training.loop import Epoch, Trained
from registry.environment import versions_of
from registry.metrics import add_model_results, model_metrics_by_size, training_tables
from registry.models import champion_of, list_versions, load, newest_trainings, resolve
from registry.results import arrays_of, evaluation, record
from registry.store import EVALUATION
from registry.training import DatasetInfo, record_training

TEXTS = ["", "abc", "1.5", "1e309", "NaN", "9" * 5000, "[" * 5000, "\x1b[31m\n", "'; --", "١٢"]
TRIALS = pd.DataFrame(one_size(10))
TRANSFER = Example("swap", np.zeros((2, 6)), np.ones((2, 6)), {"expert": np.eye(3)[:2, None]}, 15.0)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory, migrated: Path, solved: Path) -> Path:
    """A folder with two good models and an evaluation of them."""
    folder = tmp_path_factory.mktemp("project")
    shutil.copyfile(migrated, folder / "mlflow.db")
    data = DatasetInfo(str(solved), read_manifest(solved).digest(3), 12, 6)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        tuned = recipe_for("ff1", "tuned")
        for scale in (1.0, 0.5):
            trained = Trained(network(scale), tuned, 0, (Epoch(1, 1.0, 1.0, 0.1),), 1, 0.1, "cpu")
            record_training(trained, data)
        (folder / "files").mkdir()
        write_example(TRANSFER, folder / "files" / "example.npz")
        params = {"models": "models:/prolearn-ff1/1,models:/prolearn-ff1/2", "dataset_digest": "d"}
        record(EVALUATION, TRIALS, params=params, files=folder / "files")
    return folder


@pytest.fixture
def sql(
    project: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., None]]:
    """Change a database of the test's own, in the folder of the project."""
    database = project / f"{abs(hash(request.node.name))}.db"
    shutil.copyfile(project / "mlflow.db", database)
    monkeypatch.chdir(project)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{database}")

    def change(statement: str, *values: object) -> None:
        with closing(sqlite3.connect(database)) as opened:
            assert opened.execute(statement, values).rowcount > 0
            opened.commit()

    yield change
    database.unlink()


@pytest.fixture
def warned() -> Iterator[list[str]]:
    """Messages of the warnings that prolearn logs in a test."""
    found: list[str] = []
    handler, log = logging.Handler(logging.WARNING), logging.getLogger("prolearn")
    handler.emit = lambda record: found.append(record.getMessage())  # type: ignore[method-assign]
    log.addHandler(handler)
    yield found
    log.removeHandler(handler)


def run_of(version: int) -> str:
    """The training run of a version, for a statement."""
    return f"(SELECT run_id FROM model_versions WHERE version = {version})"


def prolearn(*arguments: str) -> str:
    """What a command says, which ends well."""
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, (done.output, done.exception)
    return done.output


@pytest.mark.parametrize("name", ["seed", "n_spacecraft"])
def test_a_version_whose_run_has_no_sound_number_is_left_out_with_one_warning(
    sql: Callable[..., None], name: str, warned: list[str], solved: Path
) -> None:
    for text in TEXTS:
        warned.clear()
        sql(f"UPDATE params SET value = ? WHERE key = ? AND run_uuid = {run_of(2)}", text, name)
        assert [version.version for version in list_versions()] == [1]
        assert [version.version for version in newest_trainings()] == [1]
        if text == TEXTS[0]:  # as all texts, and each time a network is loaded
            assert [one.version.version for one in networks([], solved)] == [1]
        (warning,) = warned
        assert f"prolearn-ff1/2 cannot be used: {name} of its training run" in warning
        assert warning.endswith("It is left out.") and warning.isprintable()
        assert len(warning) < 300
        with pytest.raises(InputError, match=f"prolearn-ff1/2 cannot be used: {name} of"):
            resolve("ff1/2")
        assert resolve("ff1").version == 1


LISTS = """
import os, sys

os.dup2(os.open("stderr.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
from registry.models import list_versions, newest_trainings

list_versions(), newest_trainings()
"""


def test_the_warning_is_one_line_on_stderr(
    sql: Callable[..., None], project: Path, forked: Forked
) -> None:
    sql(f"UPDATE params SET value = 'x' WHERE key = 'seed' AND run_uuid = {run_of(2)}")
    assert forked.run((), project, code=LISTS).returncode == 0
    (line,) = (project / "stderr.txt").read_text().splitlines()
    assert line.startswith("models:/prolearn-ff1/2 cannot be used")


def test_where_the_champions_run_is_nonsense_the_next_version_takes_its_place(
    sql: Callable[..., None], solved: Path
) -> None:
    sql(f"UPDATE params SET value = 'x' WHERE key = 'seed' AND run_uuid = {run_of(1)}")
    assert champion_of("prolearn-ff1") is None
    version = resolve("ff1/2")
    held = challenge(version, validation_trials(load(version)[0], solved, 3), solved)
    assert held.champion.version == 2
    assert resolve("ff1").version == 2


def test_a_champion_that_is_not_there_is_none(sql: Callable[..., None]) -> None:
    sql("UPDATE registered_model_aliases SET version = 7")
    assert champion_of("prolearn-ff1") is None
    assert [version.aliases for version in list_versions()] == [(), ()]
    with pytest.raises(InputError, match="prolearn-ff1 has no champion"):
        resolve("ff1")


@pytest.mark.parametrize("gone", ["UPDATE runs SET lifecycle_stage = 'deleted'", "purged"])
def test_a_model_whose_run_is_gone_is_used_and_its_evaluation_stays_out_of_the_run(
    sql: Callable[..., None], gone: str, project: Path, warned: list[str]
) -> None:
    version = resolve("ff1/2")
    if gone == "purged":
        for table in ("params", "tags", "metrics", "latest_metrics", "runs"):
            sql(f"DELETE FROM {table} WHERE run_uuid = {run_of(2)}")
    else:
        sql(f"{gone} WHERE run_uuid = {run_of(2)}")
    found = resolve("ff1/2")
    assert found == list_versions()[1]
    assert (found.n, found.params, found.metrics) == (0, {}, {})
    assert load("ff1/2")[1] == found
    add_model_results(version, {0: {"x": 1.0}}, project / "files", dataset=("data", "d"))
    assert f"The evaluation of {version.uri} is not added to its training run" in "".join(warned)
    assert model_metrics_by_size(version, ["x"]) == ("", {})
    training, curves = training_tables([found])
    assert (len(training), len(curves)) == (1, 0)


@pytest.mark.usefixtures("sql")
def test_an_evaluation_that_an_error_without_text_keeps_out_of_a_run_is_told_its_kind(
    project: Path, monkeypatch: pytest.MonkeyPatch, warned: list[str]
) -> None:
    def failing(*_: object) -> None:
        raise RuntimeError

    monkeypatch.setattr("registry.metrics._add_metrics", failing)
    add_model_results(resolve("ff1/2"), {}, project / "files", dataset=("data", "d"))
    assert "is not added to its training run (RuntimeError)." in "".join(warned)


ADDS = """
import os

os.dup2(os.open("stderr.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
os.environ["MLFLOW_HTTP_REQUEST_MAX_RETRIES"] = "0"
from pathlib import Path
from registry.metrics import add_model_results
from registry.models import resolve

add_model_results(resolve("ff1/2"), {0: {"x": 1.0}}, Path("files"), dataset=("data", "d"))
"""


@pytest.mark.parametrize("place", ["s3://nowhere/x", "http://127.0.0.1:1/x", "file:///dev/null"])
def test_an_evaluation_is_not_lost_where_a_models_run_cannot_take_its_part(
    sql: Callable[..., None], place: str, project: Path, forked: Forked
) -> None:
    sql(f"UPDATE runs SET artifact_uri = ? WHERE run_uuid = {run_of(2)}", place)
    assert forked.run((), project, code=ADDS).returncode == 0
    said = (project / "stderr.txt").read_text()
    assert "models:/prolearn-ff1/2 is not added to its training run" in said.splitlines()[-1]


def test_metrics_of_a_model_that_mlflow_does_not_know_go_to_its_run_alone(
    sql: Callable[..., None], project: Path
) -> None:
    sql("DELETE FROM logged_models")
    version = resolve("ff1/2")
    add_model_results(version, {0: {"x": 1.0}}, project / "files", dataset=("data", "d"))
    assert resolve("ff1/2").metrics["x"] == 1.0


@pytest.mark.parametrize("moment", [2**62, -(2**62), 0])
def test_a_time_that_is_none_is_the_first_of_1970(sql: Callable[..., None], moment: int) -> None:
    sql("UPDATE model_versions SET creation_time = ?", moment)
    sql("UPDATE runs SET start_time = ?", moment)
    assert {version.created.year for version in list_versions()} == {1970}
    assert evaluation().created.year == 1970
    assert "prolearn-ff1" in prolearn("models", "list")


@pytest.mark.parametrize(
    "text", [*TEXTS, "[1]", '{"torch": 3}', "null", '"text"', '{"a":' * 1000, '"\\ud800"']
)
def test_versions_that_are_no_mapping_of_text_are_none(text: str) -> None:
    assert versions_of({"made_with": text}) == {}
    assert versions_of({"made_with": '{"torch": "2"}'}) == {"torch": "2"}


def test_names_of_files_that_lead_elsewhere_are_passed_over(
    sql: Callable[..., None], project: Path
) -> None:
    (project / "secret.npz").write_bytes(b"secret")
    run_id = evaluation().run_id
    for name in ("../../secret.npz", "/etc/passwd", "deep/one.npz", "..npz/../x.npz"):
        sql("INSERT INTO tags VALUES (?, 'x', ?)", f"sha256/files/{name}", run_id)
    with arrays_of(evaluation()) as paths:
        assert [path.name for path in paths] == ["example.npz"]


@pytest.mark.drawn
@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning:matplotlib")
@pytest.mark.parametrize("value", [float("inf"), 1.7e308, -1.0])
def test_nonsense_in_everything_that_a_training_run_says_leaves_all_commands_working(
    sql: Callable[..., None], solved: Path, value: float
) -> None:
    numbers = "key NOT IN ('seed', 'n_spacecraft')"
    sql(f"UPDATE params SET value = 'x' || key WHERE {numbers} AND run_uuid = {run_of(2)}")
    sql(f"UPDATE tags SET value = '[' WHERE run_uuid = {run_of(2)}")
    sql(f"UPDATE latest_metrics SET value = ? WHERE run_uuid = {run_of(2)}", value)
    sql(f"UPDATE metrics SET value = ? WHERE run_uuid = {run_of(2)}", value)
    for arguments in (["list"], ["list", "--json"], ["show", "ff1/2"], ["show", "ff1", "--json"]):
        assert "prolearn-ff1" in prolearn("models", *arguments)
    assert [one.version.version for one in networks([], solved)]
    assert "report.html" in prolearn("report")
