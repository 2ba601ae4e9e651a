import json
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mlflow
import numpy as np
import pytest
from rights import room_until_told
from typer.testing import CliRunner

from cli.jobs.experiments import networks
from cli.main import app
from pipeline.errors import InputError, ProlearnError
from pipeline.experiments.trainings import training_table
from pipeline.files import write_text
from pipeline.networks.model import load as load_network
from pipeline.networks.recipes import Recipe
from pipeline.training.loop import Trained
from registry.metrics import training_tables
from registry.models import ModelVersion, list_versions, load, newest_trainings, resolve
from registry.store import TRAINING, connect
from registry.training import DatasetInfo, record_training


class Project:
    """A folder with a store, and a network to register in it as often as a test likes."""

    def __init__(
        self,
        recorded: Callable[..., ModelVersion],
        trained: Trained,
        recipe: Recipe,
        dataset: DatasetInfo,
    ) -> None:
        self.recorded, self.trained, self.recipe, self.dataset = recorded, trained, recipe, dataset

    def train(
        self,
        rmse: float,
        recipe: str = "tuned",
        seed: int = 3,
        data: DatasetInfo | None = None,
        **changes: Any,
    ) -> ModelVersion:
        how = replace(self.recipe, name=recipe, **changes)
        trained = replace(self.trained, recipe=how, seed=seed)
        return self.recorded(trained, data or self.dataset, {"valid_position_rmse": rmse})


@pytest.fixture
def project(
    recorded: Callable[..., ModelVersion], trained: Trained, recipe: Recipe, dataset: DatasetInfo
) -> Project:
    return Project(recorded, trained, recipe, dataset)


def swarm(n: int) -> tuple[np.ndarray, np.ndarray]:
    states = np.random.default_rng(n).normal(0, 100, (2, 2, n, 6))
    return states[0], states[1]


def test_a_run_tells_its_whole_story(project: Project) -> None:
    version = project.train(7.5)

    run = mlflow.MlflowClient().get_run(version.run_id)
    params, metrics, tags = run.data.params, run.data.metrics, run.data.tags
    assert run.info.status == "FINISHED"
    assert params["arch"] == "ff1" and params["recipe"] == "tuned" and params["seed"] == "3"
    assert params["learning_rate"] == str(project.recipe.learning_rate)
    assert params["dataset_digest"] == project.dataset.digest
    assert params["train_instances"] == "20" and params["device"] == "cpu"
    assert params["mixed"] == "all"
    # dense layers 108 -> 180 -> 108 for 3 craft, 6 nodes, 6 components
    assert params["parameters"] == str(108 * 180 + 180 + 180 * 108 + 108)
    history = project.trained.history
    assert metrics["best_epoch"] == project.trained.best_epoch
    assert metrics["best_valid_loss"] == min(epoch.valid_loss for epoch in history)
    assert metrics["training_seconds"] == project.trained.seconds
    assert metrics["weights_kib"] == pytest.approx(4 * int(params["parameters"]) / 1024, rel=0.01)
    assert metrics["valid_position_rmse"] == 7.5
    for tag in ("python_version", "torch_version", "numpy_version", "platform", "prolearn_version"):
        assert tags[tag]
    (given,) = run.inputs.dataset_inputs
    assert project.dataset.digest.startswith(given.dataset.digest)
    assert json.loads(given.dataset.source) == {"uri": "data/paper"}


def test_learning_curves_come_back_as_they_went_in(project: Project) -> None:
    project.train(7.5)

    training, curves = training_tables(list_versions())

    history = project.trained.history
    assert list(training["n"]) == [project.trained.model.n_train]
    assert curves.to_dict("list") == {
        "arch": ["ff1", "ff1"],
        "recipe": ["tuned", "tuned"],
        "training_seed": [3, 3],
        "epoch": [1, 2],
        "train_loss": [epoch.train_loss for epoch in history],
        "valid_loss": [epoch.valid_loss for epoch in history],
    }
    (row,) = training.to_dict("records")
    assert (row["version"], row["epochs"], row["train_instances"]) == (1, 2, 20)
    assert row["valid_loss"] == min(epoch.valid_loss for epoch in history)
    assert row["seconds"] == project.trained.seconds


def test_a_network_for_a_radius_at_which_no_rings_fit_is_registered(project: Project) -> None:
    model = project.trained.model
    project.trained = replace(
        project.trained, model=model.on(replace(model.problem, collision_radius=1000.0))
    )
    assert load(project.train(7.5))[0].problem.collision_radius == 1000


def test_the_report_shows_the_newest_version_of_each_recipe(project: Project) -> None:
    for rmse, recipe in ((3.0, "paper"), (2.0, "tuned"), (4.0, "paper")):
        project.train(rmse, recipe)

    newest = [(v.recipe, v.version) for v in newest_trainings()]
    assert newest == [("paper", 3), ("tuned", 2)]
    assert list(training_tables(newest_trainings())[0]["version"]) == [3, 2]


def test_a_copy_under_another_name_is_no_newer_training_and_has_a_name_of_its_own(
    project: Project,
) -> None:
    for rmse in (3.0, 2.0):
        project.train(rmse)
    connect().client.copy_model_version("models:/prolearn-ff1/1", "prolearn-ff1-prod")
    assert [v.uri for v in newest_trainings()] == ["models:/prolearn-ff1/2"]
    names = list(training_tables(list_versions())[0]["arch"])
    assert names == ["ff1/1", "ff1/2", "ff1/ff1-prod/1"]


def test_trainings_that_differ_in_more_than_the_seed_are_not_averaged(project: Project) -> None:
    for rmse in (3.0, 2.0):  # with the same seed
        project.train(rmse)

    training, curves = training_tables(list_versions())

    assert list(training["arch"]) == ["ff1/1", "ff1/2"]
    assert list(curves.groupby("arch").size()) == [len(project.trained.history)] * 2
    table = training_table(training).frame
    assert list(table["name"]) == ["ff1/1", "ff1/2"]
    assert list(table["paper_neurons"]) == ["180", "180"]


def test_an_empty_registry_gives_empty_tables(folder: Path) -> None:
    assert list_versions() == []
    training, curves = training_tables([])
    assert len(training) == len(curves) == 0
    assert {"arch", "recipe", "version", "valid_loss"} <= set(training.columns)


def test_a_model_is_found_by_every_name_it_has(project: Project) -> None:
    first, second, third = (
        project.train(r, n) for r, n in ((3, "paper"), (2, "tuned"), (9, "paper"))
    )
    assert [v.version for v in (first, second, third)] == [1, 2, 3]

    names = {
        "ff1": 1,
        "prolearn-ff1": 1,
        "ff1@champion": 1,
        "prolearn-ff1@champion": 1,
        "models:/prolearn-ff1@champion": 1,
        "ff1/2": 2,
        "prolearn-ff1/2": 2,
        "models:/prolearn-ff1/2": 2,
        f"models:/{second.model_id}": 2,
        "ff1:tuned": 2,
        "ff1:paper": 3,
        "models:/prolearn-ff1/latest": 3,
    }
    assert {name: resolve(name).version for name in names} == names
    assert resolve("ff1").aliases == ("champion",)
    assert resolve("ff1/2").aliases == ()
    assert resolve("ff1/2") == second == list_versions()[1]


def test_an_unknown_model_gives_a_sentence_with_those_there_are(project: Project) -> None:
    project.train(1.0)
    numbered = ("models:/m-0123456789abcdef", "m-1", "ff1/99999999999999999999")
    for name in ("lstm9", "ff1:best", "ff1/8", "ff1/two", "ff1@crown", *numbered):
        there = r"prolearn-ff1/1 \(tuned, champion\).*prolearn train"
        with pytest.raises(InputError, match=f"There is no model {name!r} .*{there}"):
            resolve(name)


def test_a_model_whose_champion_was_deleted_is_told_how_it_gets_another(project: Project) -> None:
    names = ("ff1", "models:/prolearn-ff1", "ff1@champion")
    for _ in range(3):
        project.train(1.0)
    connect().client.delete_model_version("prolearn-ff1", "1")
    advice = "prolearn models promote prolearn-ff1 --version"
    for name in names:
        with pytest.raises(InputError, match=rf"ff1 has no champion; .*\(2, 3\).*`{advice} V`\.$"):
            resolve(name)
    done = CliRunner().invoke(app, [*advice.split()[1:], "3"])
    assert done.exit_code == 0, done.output
    assert [resolve(name).version for name in names] == [3, 3, 3]


def test_versions_keep_their_runs_where_the_experiment_is_renamed_or_a_run_deleted(
    project: Project,
) -> None:
    first, second = project.train(1.0), project.train(2.0)
    store = connect()
    store.client.rename_experiment(store.experiments[TRAINING], "ours")
    assert list_versions() == [replace(first, aliases=("champion",)), second]
    assert len(training_tables(list_versions())[1]) == 2 * len(project.trained.history)
    store.client.delete_run(second.run_id)
    assert [v.params for v in list_versions()] == [first.params, {}]


@pytest.mark.parametrize(
    "name", ["", "two words", "models:/", "ff1@", "a'; DROP TABLE runs", "../x/1"]
)
def test_what_is_no_name_at_all_is_refused_with_the_forms(folder: Path, name: str) -> None:
    with pytest.raises(InputError, match="ARCH:RECIPE, NAME@ALIAS, NAME/VERSION"):
        resolve(name)


def test_mlflow_alone_loads_a_model_and_predicts_for_any_n(
    project: Project, monkeypatch: pytest.MonkeyPatch
) -> None:
    version = project.train(1.0)
    monkeypatch.setenv("MLFLOW_ALLOW_PICKLE_DESERIALIZATION", "false")

    loaded = mlflow.pyfunc.load_model(version.uri)
    for n in (1, 10, 31, 100):
        initial, goal = swarm(n)
        states = loaded.predict({"initial": initial, "goal": goal})
        assert states.shape == (2, n, 6, 6)
        np.testing.assert_array_equal(states, project.trained.model.predict(initial, goal))


@pytest.mark.parametrize(("name", "value"), [("initial", np.nan), ("goal", np.inf)])
def test_states_that_are_not_finite_are_refused_by_mlflow_s_model_and_by_ours(
    project: Project, name: str, value: float
) -> None:
    version = project.train(1.0)
    states = dict(zip(("initial", "goal"), swarm(3), strict=True))
    states[name][1, 2, 5] = value
    said = f"^{name} has values that are not finite; expected states in m and m/s.$"
    with pytest.raises(InputError, match=said):
        load(version)[0].predict(**states)
    with pytest.raises(InputError, match=said):
        mlflow.pyfunc.load_model(version.uri).predict(states)


def test_the_signature_and_the_input_example_go_with_the_model(project: Project) -> None:
    loaded = mlflow.pyfunc.load_model(project.train(1.0).uri)
    example = loaded.input_example
    assert loaded.predict(example).shape == (1, 2, 6, 6)
    initial, goal = swarm(3)
    with pytest.raises(mlflow.exceptions.MlflowException, match="does not match expected shape"):
        loaded.predict({"initial": initial[..., :5], "goal": goal})
    with pytest.raises(mlflow.exceptions.MlflowException, match="goal"):
        loaded.predict({"initial": initial})


def test_loading_gives_the_registered_network_with_its_version(project: Project) -> None:
    registered = project.train(1.0)
    model, version = load("ff1")
    again, same = load(registered)
    initial, goal = swarm(4)
    wanted = project.trained.model.predict(initial, goal)
    np.testing.assert_array_equal(model.predict(initial, goal), wanted)
    np.testing.assert_array_equal(again.predict(initial, goal), wanted)
    assert version.uri == same.uri == "models:/prolearn-ff1/1"


def test_nothing_in_the_registry_is_a_pickle(project: Project, folder: Path) -> None:
    project.train(1.0)
    files = [path for path in (folder / "mlruns").rglob("*") if path.is_file()]
    assert {path.name for path in files} >= {"MLmodel", "weights.safetensors", "model.json"}
    for path in files:
        assert path.suffix not in {".pkl", ".pickle", ".pt", ".pt2", ".pth", ".joblib", ".bin"}
        assert not path.read_bytes().startswith((b"\x80", b"PK")), path
    (described,) = (path.read_text() for path in files if path.name == "MLmodel")
    assert "loader_module: registry.pyfunc" in described
    assert not re.search("python_model|cloudpickle", described)


def test_a_model_that_an_earlier_version_registered_is_loaded_by_mlflow_and_by_us(
    project: Project, folder: Path
) -> None:
    """Earlier versions named ``registry.flavor`` as the module that loads a model."""
    version = project.train(1.0)
    (described,) = (folder / "mlruns").rglob("MLmodel")
    text = described.read_text()
    assert "loader_module: registry.pyfunc\n" in text
    described.write_text(text.replace("registry.pyfunc\n", "registry.flavor\n"))
    initial, goal = swarm(3)
    states = mlflow.pyfunc.load_model(version.uri).predict({"initial": initial, "goal": goal})
    np.testing.assert_array_equal(states, load(version)[0].predict(initial, goal))


class Payload:
    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, tuple[Path]]:
        return Path.touch, (self.mark,)


@pytest.mark.parametrize("name", ["weights.safetensors", "model.json"])
def test_a_pickle_in_place_of_a_models_file_does_not_run(
    project: Project, folder: Path, name: str
) -> None:
    version = project.train(1.0)
    (path,) = (folder / "mlruns").rglob(name)
    content = pickle.dumps(Payload(folder / "ran"))
    path.write_bytes(content)

    with pytest.raises(InputError, match=name):
        load(version)
    with pytest.raises(InputError, match=name):
        mlflow.pyfunc.load_model(version.uri)
    assert not (folder / "ran").exists()
    pickle.loads(content)
    assert (folder / "ran").exists(), "the payload would have worked"


def test_a_pickled_model_in_place_of_ours_does_not_run_when_we_load_it(
    project: Project, folder: Path
) -> None:
    version = project.train(1.0)
    (described,) = (folder / "mlruns").rglob("MLmodel")
    (described.parent / "python_model.pkl").write_bytes(pickle.dumps(Payload(folder / "ran")))
    described.write_text(
        "flavors:\n  python_function:\n    loader_module: mlflow.pyfunc.model\n"
        "    python_model: python_model.pkl\n    cloudpickle_version: '3'\n"
    )
    model, _ = load(version)
    initial, goal = swarm(2)
    wanted = project.trained.model.predict(initial, goal)
    np.testing.assert_array_equal(model.predict(initial, goal), wanted)
    assert not (folder / "ran").exists()


@pytest.mark.drawn
def test_a_run_keeps_its_learning_curves_as_a_figure(project: Project, folder: Path) -> None:
    project.train(1.0)
    (figure,) = (folder / "mlruns").rglob("figures/learning_curve.png")
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_a_model_whose_artifacts_are_gone_gives_a_sentence(project: Project, folder: Path) -> None:
    project.train(1.0)
    (folder / "mlruns").rename(folder / "elsewhere")
    with pytest.raises(ProlearnError, match=r"docs/mlflow\.md"):
        load("ff1")


def test_a_training_that_cannot_be_recorded_fails_its_run_and_keeps_the_weights(
    project: Project, folder: Path
) -> None:
    connect()
    (folder / "mlruns").write_text("a file where a folder is needed")

    with pytest.raises(ProlearnError, match=r"kept in .*unregistered"):
        project.train(1.0)

    assert list_versions() == []
    store = connect()
    (run,) = store.client.search_runs([store.experiments[TRAINING]])
    assert run.info.status == "FAILED"
    (kept,) = (folder / "unregistered").iterdir()
    assert kept.name.startswith("ff1-")
    assert (kept / "weights.safetensors").stat().st_size > 150_000


def test_a_network_is_kept_where_there_is_no_room_for_temporary_files(
    trained: Trained, dataset: DatasetInfo, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "full").write_text("a file where a folder is needed")
    monkeypatch.setattr("tempfile.tempdir", str(folder / "full"))
    with pytest.raises(ProlearnError, match=r"/full/.*\. The trained network is kept in "):
        record_training(trained, dataset)
    (kept,) = (folder / "unregistered").iterdir()
    assert load_network(kept).digest == trained.model.digest
    assert (kept / "training.json").exists()


def test_a_network_for_which_the_disk_has_no_room_is_not_kept_in_part(
    project: Project, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    connect()
    (folder / "mlruns").write_text("a file where a folder is needed")
    with room_until_told() as fill:

        def write(path: Path, text: str) -> None:
            fill()
            write_text(path, text)

        monkeypatch.setattr("registry.training.write_text", write)
        with pytest.raises(
            ProlearnError, match=r"be kept in .*/unregistered/\S+ \(File too large\);"
        ):
            project.train(1.0)
    assert [*(folder / "unregistered").iterdir()] == []


def named(data: Path, *references: str) -> list[tuple[str, int]]:
    return [(net.evaluated.label, net.version.version) for net in networks(references, data)]


def test_trainings_with_other_seeds_stand_side_by_side(
    project: Project, solved: Path, on_solved: DatasetInfo
) -> None:
    for seed in (1, 0, 1):
        project.train(2.0, seed=seed, data=on_solved)

    newest = newest_trainings()
    assert [(v.training_seed, v.version) for v in newest] == [(0, 2), (1, 3)]
    assert named(solved) == [("ff1 tuned", 2), ("ff1 tuned", 3)]
    assert named(solved, "ff1/1", "ff1/3") == [("ff1/1 tuned", 1), ("ff1/3 tuned", 3)]


@pytest.mark.parametrize("change", ["data", "recipe"])
def test_trainings_that_differ_in_more_than_their_seed_are_never_averaged(
    once: Callable[..., object],
    project: Project,
    solved: Path,
    on_solved: DatasetInfo,
    change: str,
) -> None:
    def train() -> None:
        for seed in (0, 1, 2):
            project.train(2.0, seed=seed, data=on_solved)

    once("three seeds", train)
    if change == "data":
        project.train(2.0, seed=0)
    else:
        project.train(2.0, seed=0, data=on_solved, learning_rate=0.1)

    assert [(v.training_seed, v.version) for v in newest_trainings()] == [(0, 4)]
    if change == "data":
        # On the first three's own data they are the newest.
        assert named(solved) == [("ff1 tuned", 1), ("ff1 tuned", 2), ("ff1 tuned", 3)]
    else:
        assert named(solved) == [("ff1 tuned", 4)]
    both = [("ff1/4 tuned", 4), ("ff1/2 tuned", 2)]  # by their seeds, however they are named
    assert named(solved, "ff1/2", "ff1/4") == named(solved, "ff1/4", "ff1/2") == both


def test_experiments_take_no_model_that_was_trained_on_other_data_unless_it_is_named(
    project: Project, solved: Path
) -> None:
    assert networks([], solved) == []
    project.train(2.0)
    with pytest.raises(InputError, match=r"no model was trained on .*--models .* on data/paper"):
        networks([], solved)
    assert named(solved, "ff1") == [("ff1 tuned", 1)]
