"""The report is one story: an evaluation, and what else is of its models on its data."""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from blank import leave_blank
from typer.testing import CliRunner

from cli.jobs.experiments import evaluate, transfer_times, warmstart
from cli.jobs.report import report
from cli.main import app
from cli.settings import Evaluation, TransferTimes, WarmStarts
from pipeline.dataset.manifest import read_manifest
from pipeline.errors import InputError
from pipeline.networks.recipes import Recipe
from pipeline.parallel.workers import Workers
from pipeline.training.loop import Trained
from registry.models import list_versions
from registry.store import connect, opened, recorded_run
from registry.training import DatasetInfo, record_training

CRAFT = 3


@pytest.fixture(scope="module")
def place(
    tmp_path_factory: pytest.TempPathFactory,
    migrated: Path,
    solved: Path,
    trained: Trained,
    trained_lstm: Trained,
) -> tuple[Path, dict[str, str]]:
    """A folder with a store that has all experiments, made once, and their run ids."""
    path = tmp_path_factory.mktemp("story")
    shutil.copy(migrated, path / "mlflow.db")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(path)
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        leave_blank(patch)
        return path, experiments(solved, trained, trained_lstm)


@contextmanager
def inside(place: tuple[Path, dict[str, str]]) -> Iterator[Path]:
    """Make the store's folder the current one for the block."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place[0])
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        yield place[0]


@pytest.fixture
def done(place: tuple[Path, dict[str, str]]) -> Iterator[dict[str, str]]:
    """The run ids; the current folder is that of the store."""
    with inside(place):
        yield place[1]


def experiments(solved: Path, trained: Trained, trained_lstm: Trained) -> dict[str, str]:
    """All experiments with ff1 alone, then an evaluation and times with lstm1, too."""
    on_solved = DatasetInfo(str(solved), read_manifest(solved).digest(CRAFT), 12, 6)
    record_training(trained, on_solved)
    alone = Workers(jobs=1)
    data, sizes = str(solved), f"{CRAFT}"
    times = TransferTimes(data=data, n=CRAFT, nodes="6", trials=1)
    evaluated = Evaluation(data=data, sizes=sizes, trials=2, timed=1)
    seeds = WarmStarts(data=data, sizes=sizes, trials=1)
    runs = {
        "evaluation": evaluate(evaluated, workers=alone),
        "expert": warmstart(seeds),
        "plain": warmstart(replace(seeds, optimizer="plain")),
        "times": transfer_times(times, workers=alone),
    }
    record_training(trained_lstm, on_solved)
    runs["later evaluation"] = evaluate(evaluated, workers=alone)
    runs["later times"] = transfer_times(times, workers=alone)
    return {name: outcome.run_id for name, outcome in runs.items()}


@contextmanager
def other_versions(changes: dict[str, dict[str, str]]) -> Iterator[None]:
    """Runs say for the block that they were made with other versions, by run id."""
    client = connect().client
    usual = {run: client.get_run(run).data.tags["made_with"] for run in changes}
    for run, tag in usual.items():
        client.set_tag(run, "made_with", json.dumps(json.loads(tag) | changes[run]))
    yield
    for run, tag in usual.items():
        client.set_tag(run, "made_with", tag)


@pytest.fixture(scope="module")
def newest(place: tuple[Path, dict[str, str]]) -> Path:
    """The folder of a report of the newest evaluation, made once."""
    with inside(place) as folder, pytest.MonkeyPatch.context() as patch:
        leave_blank(patch)
        return report(folder / "newest").markdown.parent


@pytest.fixture(scope="module")
def earlier(place: tuple[Path, dict[str, str]]) -> Path:
    """The folder of a report of the first evaluation, which records a plug-in network."""
    run = place[1]["evaluation"]
    changes = {run: {"theirs:networks": "1.2+code.a"}}
    with (
        inside(place) as folder,
        other_versions(changes),
        pytest.MonkeyPatch.context() as patch,
    ):
        leave_blank(patch)
        said = CliRunner().invoke(app, ["report", "--out", "earlier", "--evaluation", run])
        assert said.exit_code == 0, said.output
        return folder / "earlier"


def made(out: Path) -> tuple[str, "pd.Series[str]", pd.DataFrame]:
    """The text, the runs by part, and the table of the trainings."""
    tables = (pd.read_csv(out / "tables" / f"{name}.csv") for name in ("provenance", "training"))
    provenance, training = tables
    runs = provenance.set_index("part")["run"]
    return (out / "report.md").read_text(), runs, training


def test_a_report_of_an_earlier_evaluation_takes_what_is_of_its_models_alone(
    done: dict[str, str], earlier: Path
) -> None:
    text, runs, training = made(earlier)
    assert dict(runs.iloc[:4]) == {
        "Experiments 1 and 2, examples": done["evaluation"],
        "Experiment 3, expert": done["expert"],
        "Experiment 3, plain": done["plain"],
        "Experiment 4": done["times"],
    }
    assert list(runs.index[4:]) == ["Training ff1:tuned, seed 3"]
    assert list(training["arch"]) == ["ff1"]
    assert "is left out" not in text
    assert "LSTM1" not in text
    assert "was made with" not in text  # what one run alone has decides nothing in the others


def test_a_report_goes_into_no_folder_of_trials(tmp_path: Path) -> None:
    (tmp_path / "loop=open-loop").mkdir()
    (tmp_path / "_manifest.json").touch()
    with pytest.raises(InputError, match="is a folder of trials; expected another"):
        report(tmp_path)


def test_a_full_disk_is_not_taken_for_damaged_results(
    done: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("cli.jobs.report.build_report", full)
    with pytest.raises(OSError, match="No space left on device"):
        report(tmp_path)


@pytest.mark.parametrize(
    ("out", "error", "words"),
    [
        ("s3://bucket/reports", InputError, "s3://bucket/reports.* is a URL; expected a path"),
        ("memory://reports", InputError, "is a URL; expected a path"),
        ("/proc/reports", OSError, "/proc/reports/report.md"),
        ("/dev/null", InputError, "/dev/null is a file; expected a folder"),
    ],
)
def test_a_report_for_where_none_can_be_written_is_refused_before_anything_is_read(
    out: str, error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        report(Path(out), "0" * 32)  # no such evaluation: it is not looked for


def test_what_is_of_other_models_is_left_out_and_said(done: dict[str, str], newest: Path) -> None:
    text, runs, training = made(newest)
    assert runs["Experiments 1 and 2, examples"] == done["later evaluation"]
    assert runs["Experiment 4"] == done["later times"]
    assert not any("Experiment 3" in part for part in runs.index)
    assert set(training["arch"]) == {"ff1", "lstm1"}
    for optimizer in ("expert", "plain"):
        assert f"Experiment 3, {optimizer}: the newest run ({done[optimizer]}, 20" in text
        command = f"`prolearn warmstart --optimizer {optimizer}` with --data and --models of this"
        assert command in text
    assert "No warm starts of these models on these data" in text


def test_other_versions_are_said_and_what_an_earlier_version_left_in_the_store_changes_nothing(
    done: dict[str, str], earlier: Path, trained: Trained, recipe: Recipe, on_solved: DatasetInfo
) -> None:
    """The store has a run of the removed `make ablate`, and a network by a recipe of its own."""
    gone = "prolearn-ablations"
    with opened(gone) as store, recorded_run(store, gone, "ablations", {}):
        pass
    record_training(replace(trained, recipe=replace(recipe, name="no-third")), on_solved)
    changes = {
        done["evaluation"]: {"theirs:networks": "1.2+code.a"},
        done["plain"]: {"theirs:networks": "1.2+code.b"},
        done["times"]: {"torch": "1.0"},
    }
    with other_versions(changes):
        report(Path("other"), done["evaluation"])
    before, text = (made(path)[0].split("\n\n") for path in (earlier, Path("other")))
    plain, times = (part for part in text if "was made with" in part)
    assert "Experiment 4 was made with torch 1.0, the evaluation with 2" in times
    theirs = "made with theirs:networks 1.2+code.b, the evaluation with 1.2+code.a."
    assert f"Experiment 3, plain was {theirs}" in plain
    assert [part for part in text if part not in (plain, times)] == before
    named = [(version.arch, version.recipe) for version in list_versions()]
    assert named == [("ff1", "tuned"), ("ff1", "no-third"), ("lstm1", "tuned")]


def test_trainings_keep_the_names_of_the_evaluation_where_one_of_them_was_deleted(
    folder: Path,
    solved: Path,
    trained: Trained,
    trained_lstm: Trained,
    on_solved: DatasetInfo,
) -> None:
    """Trainings with other seeds share one name; those with the same seed are named by version."""
    for one, seeds in ((trained, (0, 0)), (trained_lstm, (0, 1))):
        versions = [record_training(replace(one, seed=seed), on_solved) for seed in seeds]
    models = "ff1/1,ff1/2,lstm1/1,lstm1/2"
    asked = Evaluation(models=models, data=str(solved), sizes=f"{CRAFT}", trials=1, timed=0)
    evaluate(asked, workers=Workers(1))
    client = connect().client
    client.delete_model_version("prolearn-ff1", "1")
    client.delete_run(versions[0].run_id)
    report(Path("fewer"))
    training = made(Path("fewer"))[2]
    assert set(training["arch"]) == {"ff1/2", "lstm1"}
