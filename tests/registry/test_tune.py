import shutil
import sqlite3
from contextlib import closing
from math import inf
from pathlib import Path
from shlex import split
from typing import Any

import optuna
import pytest
from typer.testing import CliRunner

from cli.jobs.tune import Tuned, tune
from cli.main import app
from cli.settings import TuningSettings
from pipeline.errors import InputError, ProlearnError
from pipeline.networks.supervised import Supervised
from pipeline.parallel.workers import Workers
from pipeline.progress import SILENT, Progress
from pipeline.training import data as sources
from pipeline.training.search import SPACE, drawn_trials, open_study
from registry.models import list_versions
from registry.store import connect


def search(data: Path, trials: int, progress: Progress = SILENT, **options: Any) -> Tuned:
    asked = {"arch": "ff1", "data": str(data), "n": 3, "device": "cpu", "epochs": 2, **options}
    return tune(TuningSettings(trials=trials, **asked), workers=Workers(1, progress=progress))


def runs(name: str) -> list[Any]:
    client = connect().client
    (experiment,) = client.search_experiments(filter_string=f"name = '{name}'")
    found: list[Any] = client.search_runs([experiment.experiment_id])
    return found


class Counting(Progress):
    """Counts the trials that are complete, and interrupts the search after some of them."""

    def __init__(self, until: int | None = None) -> None:
        self.until, self.expected, self.complete = until, 0, 0

    def expect(self, total: int) -> None:
        self.expected = total

    def done(self, units: int = 1, note: str = "", *, failed: int = 0) -> None:
        self.complete += units
        if self.complete == self.until:
            raise KeyboardInterrupt


def test_an_interrupted_search_goes_on_to_the_same_number_of_nested_runs(
    folder: Path, solved: Path
) -> None:
    with pytest.raises(KeyboardInterrupt):
        search(solved, 4, progress=Counting(until=2))
    counted = Counting()
    found = search(solved, 4, progress=counted)
    again = search(solved, 4)

    assert counted.complete == counted.expected == 2, "what was complete is not done again"
    assert (again.trials, again.value, again.best) == (4, found.value, found.best)
    assert found.run_id == again.run_id
    with closing(sqlite3.connect(folder / "optuna.db")) as database:
        query = "SELECT value FROM trial_values ORDER BY value"
        values = [value for (value,) in database.execute(query)]
    assert len(set(values)) == 4, "trials that begin again with the same settings teach nothing"
    assert found.value == min(values)

    trials = [r for r in runs("prolearn-tuning") if "trial" in r.data.params]
    assert {r.data.tags["mlflow.parentRunId"] for r in trials} == {found.run_id}
    best = min(trials, key=lambda r: r.data.metrics["valid_position_rmse"])
    assert best.data.metrics["valid_position_rmse"] == found.value
    assert {k: best.data.params[k] for k in found.best} == {
        k: str(v) for k, v in found.best.items()
    }
    assert runs("prolearn-training") == [] and list_versions() == [], "a search registers nothing"


def test_a_search_whose_run_was_deleted_goes_on_under_a_new_one(folder: Path, solved: Path) -> None:
    first = search(solved, 1)
    connect().client.delete_run(first.run_id)
    second = search(solved, 2)
    assert (second.trials, second.study) == (2, first.study)
    found = {run.info.run_name: run for run in runs("prolearn-tuning")}
    assert found[first.study].info.run_id == second.run_id != first.run_id
    assert found["trial-1"].data.tags["mlflow.parentRunId"] == second.run_id


def test_the_command_that_a_search_names_trains_what_its_best_trial_did(
    folder: Path, solved: Path
) -> None:
    shutil.copytree(solved, folder / "my data")
    asked = "tune --arch ff1 --n 3 --device cpu --epochs 3 --seed 1 --trials 2 --data"
    searched = CliRunner().invoke(app, [*asked.split(), "my data"])
    assert searched.exit_code == 0, searched.output
    _, _, command = searched.output.partition("Train with its settings: prolearn ")
    trained = CliRunner().invoke(app, [*split(command), "--device", "cpu"])
    assert trained.exit_code == 0, trained.output
    (version,) = list_versions()
    best = min(r.data.metrics.get("valid_position_rmse", inf) for r in runs("prolearn-tuning"))
    assert version.metrics["valid_position_rmse"] == pytest.approx(best, rel=1e-3)


def test_what_is_drawn_next_does_not_depend_on_the_order_of_results(tmp_path: Path) -> None:
    def drawn(path: Path, step: int) -> list[Any]:
        found: list[Any] = []
        with open_study(path, "a search") as study:
            for count in (10, 2, 2):  # by Optuna's model once ten are complete
                with drawn_trials(study, path, count, seed=1) as some:
                    for number in [*some][::step]:
                        study.tell(number, some[number]["learning_rate"])
                found += some.values()
        return found

    found = drawn(tmp_path / "first.db", 1)
    assert drawn(tmp_path / "second.db", -1) == found
    assert len({one["learning_rate"] for one in found}) == 14


def test_a_trial_that_diverges_has_failed_and_is_not_made_again(
    folder: Path, solved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rates = iter([1e30, 1e-3, 1e-3])
    monkeypatch.setitem(SPACE, "learning_rate", lambda trial, name: next(rates))
    counted = Counting()
    assert search(solved, 3, counted).trials == 2
    study = optuna.load_study(study_name=None, storage=f"sqlite:///{folder}/optuna.db")
    assert [one.state.name for one in study.trials] == ["FAIL", "COMPLETE", "COMPLETE"]
    assert (counted.complete, counted.expected) == (2, 3)
    of = {r.info.run_name: r.info.status for r in runs("prolearn-tuning")}
    assert of["trial-0"] == "FAILED" and of["trial-1"] == "FINISHED"


def test_a_search_sees_no_test_data(folder: Path, solved: Path, monkeypatch: Any) -> None:
    asked: list[str] = []
    read = sources.solved_examples

    def watched(data: Path, n: int, split: str, memory: float) -> Any:
        asked.append(split)
        return read(data, n, split, memory)

    monkeypatch.setattr(sources, "solved_examples", watched)
    search(solved, 1)
    assert asked == ["train", "valid"]


def test_a_storage_of_something_else_gives_a_sentence(folder: Path, solved: Path) -> None:
    (folder / "notes.db").write_bytes(b"these are notes, not a database\n" * 100)
    with pytest.raises(ProlearnError, match=r"notes\.db failed .*--storage"):
        search(solved, 1, storage=Path("notes.db"))


def test_a_storage_may_have_any_name(tmp_path: Path) -> None:
    path = tmp_path / "tried?" / "a%20b.db"
    with open_study(path, "any"):
        assert {one.name for one in path.parent.iterdir()} == {"a%20b.db", "a%20b.db.lock"}


@pytest.mark.parametrize(
    ("storage", "words"),
    [
        ("here", "is the folder .*here; expected"),
        ("file/x.db", "file is a file; expected a folder"),
    ],
)
def test_a_storage_that_can_be_no_file_is_refused(
    folder: Path, solved: Path, storage: str, words: str
) -> None:
    (folder / "here").mkdir()
    (folder / "file").touch()
    with pytest.raises(InputError, match=words):
        search(solved, 1, storage=Path(storage))


def test_less_than_one_trial_is_refused(folder: Path, solved: Path) -> None:
    with pytest.raises(InputError, match="trials is 0"):
        search(solved, 0)


def test_jobs_without_trials_to_train_at_once_are_refused(folder: Path, solved: Path) -> None:
    how = TuningSettings(arch="ff1", data=str(solved), n=3, trials=2)
    with pytest.raises(InputError, match=r"jobs is 2 .* such as --at-once 5"):
        tune(how, workers=Workers(2))


def test_an_objective_that_no_trial_records_is_refused(
    folder: Path, solved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Supervised, "objective", "beauty")
    with pytest.raises(InputError, match=r"'ff1' names 'beauty' .*valid_position_rmse"):
        search(solved, 1)


def test_trials_from_another_seed_are_another_search(folder: Path, solved: Path) -> None:
    first = search(solved, 1)
    other = search(solved, 1, seed=1)
    assert other.study != first.study
    assert other.run_id != first.run_id
    seeds = [r.data.params["seed"] for r in runs("prolearn-tuning") if "trial" in r.data.params]
    assert sorted(seeds) == ["0", "1"]


def test_a_search_leaves_alone_what_an_architecture_has_no_use_for(
    folder: Path, solved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Supervised, "unused", frozenset({"dropout", "collision_weight"}))
    assert {*search(solved, 1).best} == {"learning_rate", "batch_size", "interior"}
