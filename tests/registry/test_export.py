import json
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from short_transfer import PROBLEM
from typer.testing import CliRunner

from cli.main import app
from pipeline.dataset.examples import Examples
from pipeline.errors import ProlearnError
from pipeline.networks.architecture import recipe_for
from pipeline.networks.model import Model
from pipeline.networks.onnx_export import ExportedGraph, _traced_for, traced
from pipeline.orbit.dynamics import cw_matrices
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import straight_line
from pipeline.scenario import draw
from pipeline.training.loop import Trained, train
from registry.metrics import add_model_results
from registry.models import resolve
from registry.training import DatasetInfo, record_training

pytestmark = pytest.mark.usefixtures("known_operators", "known_graphs")


@pytest.fixture(scope="module")
def graphs() -> dict[object, torch.onnx.ONNXProgram]:
    """Cache of the graphs that have been traced, by model, output and number of craft."""
    return {}


@pytest.fixture
def known_graphs(
    graphs: dict[object, torch.onnx.ONNXProgram], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reuse graphs that an earlier test has traced, since tracing takes most of a second."""

    def known(n: int | None, module: ExportedGraph, outputs: Sequence[str], model: Model) -> object:
        what = model.digest, n, *outputs
        if what not in graphs:
            graphs[what] = _traced_for(n, module, outputs, model)
        return graphs[what]

    monkeypatch.setattr("pipeline.networks.onnx_export._traced_for", known)


def export(*arguments: str) -> str:
    done = CliRunner().invoke(app, ["models", "export", *arguments])
    assert done.exit_code == 0, done.output
    return done.output


def session(path: Path) -> onnxruntime.InferenceSession:
    return onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])


def ends(n: int) -> dict[str, np.ndarray]:
    """End states of a swarm's size, in what float32 can hold."""
    states = np.random.default_rng(n).normal(size=(2, 3, n, 6)) * [200, 300, 100, 0.2, 0.3, 0.1]
    return dict(zip(("initial", "goal"), states.astype(np.float32), strict=True))


def assert_answers_like(path: Path, model: Model, n: int) -> None:
    given = ends(n)
    (states,) = session(path).run(None, given)
    wanted = model.predict(*(e.astype(float) for e in given.values()))
    size = np.sqrt(np.square(wanted).mean(axis=(0, 1, 2)))
    np.testing.assert_allclose(states / size, wanted / size, rtol=0, atol=1e-5)


def trained_on_straight_lines(arch: str, problem: Problem, craft: int) -> Trained:
    """A network trained for one epoch on straight-line trajectories."""
    drawn = [draw("rings", 0, craft, k, problem) for k in range(4)]
    first, last = (np.stack([getattr(one, end) for one in drawn]) for end in ("initial", "goal"))
    given = Examples(problem, first, last, straight_line(first, last, problem.nodes))
    few = replace(recipe_for(arch, "tuned"), epochs=1)
    return train(arch, few, given, given, device="cpu")


@pytest.fixture(scope="module")
def short_lstm() -> Trained:
    """An LSTM for the fewest nodes: each is a copy of its cells in the graph, and takes long."""
    return trained_on_straight_lines("lstm1", Problem(nodes=3, time_step=600.0), 3)


@pytest.fixture
def ff1(recorded: Callable[..., object], trained: Trained, dataset: DatasetInfo) -> Model:
    """A registered network for three craft."""
    recorded(trained, dataset)
    return trained.model


def test_an_lstm_becomes_one_file_for_any_number_of_craft(
    folder: Path, short_lstm: Trained, dataset: DatasetInfo
) -> None:
    record_training(short_lstm, dataset)

    said = export("lstm1", "--format", "onnx")

    path = folder / "prolearn-lstm1-v1.onnx"
    for n in (1, 2, 10, 47, 100):
        assert_answers_like(path, short_lstm.model, n)
    onnx.checker.check_model(onnx.load(path), full_check=True)
    # 4 gates of 6 inputs and 180 units, two biases each, and a layer from 180 to 6
    weights = 4 * (4 * (6 * 180 + 180 * 180 + 2 * 180) + 180 * 6 + 6)
    assert weights <= path.stat().st_size < weights + 64 * 1024
    assert f"{path.stat().st_size / 1024:.0f} KiB, for any n" in said
    assert "on one core" in said and "n=100" in said
    assert {p.name for p in folder.glob("prolearn-*")} == {path.name, f"{path.name}.md"}


def test_a_feed_forward_file_serves_up_to_its_training_s_size_and_its_card_says_no_measurements(
    folder: Path, ff1: Model
) -> None:
    assert "for n = 1 to 3" in export("ff1/1", "--out", "small.onnx")
    for n in (1, 2, 3):
        assert_answers_like(folder / "small.onnx", ff1, n)
    card = (folder / "small.onnx.md").read_text(encoding="utf-8")
    assert "not measured" in card and "apart. Check" in card


def test_a_feed_forward_file_of_a_training_on_single_craft_is_for_one_craft(
    folder: Path, dataset: DatasetInfo
) -> None:
    made = trained_on_straight_lines("ff1", PROBLEM, 1)
    record_training(made, dataset)
    assert "for n = 1." in export("ff1", "--out", "one.onnx")
    assert_answers_like(folder / "one.onnx", made.model, 1)


def test_several_models_go_into_a_folder_under_their_own_names_for_any_one_size_by_request(
    folder: Path, ff1: Model, short_lstm: Trained, dataset: DatasetInfo
) -> None:
    record_training(short_lstm, dataset)
    said = export("ff1", "lstm1", "--n", "12", "--out", "onboard/new")

    names = ["prolearn-ff1-v1.onnx", "prolearn-lstm1-v1.onnx"]
    wanted = {name + end for name in names for end in ("", ".md")}
    assert {path.name for path in (folder / "onboard" / "new").iterdir()} == wanted
    for name, model in zip(names, (ff1, short_lstm.model), strict=True):
        assert_answers_like(folder / "onboard" / "new" / name, model, 12)
        assert session(folder / "onboard" / "new" / name).get_inputs()[0].shape == ["batch", 12, 6]
        assert f"{name}:" in said
    assert said.count("for n = 12.") == 2
    assert "exporting: 2/2" in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("ff1", "lstm2"), "no model 'lstm2'"),
        (("ff1", "prolearn-ff1/1"), "prolearn-ff1-v1.onnx is asked for 2 times"),
    ],
)
def test_one_wrong_name_among_several_stops_all_before_anything_is_written(
    arguments: tuple[str, ...], words: str, folder: Path, ff1: Model
) -> None:
    done = CliRunner().invoke(app, ["models", "export", *arguments])
    assert (done.exit_code, list(folder.glob("*onnx*"))) == (2, [])
    assert words in done.output


def test_a_folder_in_place_of_the_file_is_refused(folder: Path, ff1: Model) -> None:
    (folder / "here").mkdir()
    done = CliRunner().invoke(app, ["models", "export", "ff1", "--out", "here"])
    assert done.exit_code == 2
    assert "here is a folder; expected the name of a file" in done.output


def test_a_flown_file_gives_controls_that_obey_the_dynamics_and_meet_the_goal(
    folder: Path, ff1: Model
) -> None:
    export("ff1", "--flown", "--out", "flown.onnx")

    given = ends(3)
    states, controls = session(folder / "flown.onnx").run(None, given)

    assert (states.shape, controls.shape) == ((3, 3, 6, 6), (3, 3, 5, 3))
    A, B = cw_matrices(ff1.problem.mean_motion, ff1.problem.time_step)
    flown = given["initial"].astype(float)
    for t in range(5):
        flown = flown @ A.T + controls[:, :, t] @ B.T
        np.testing.assert_allclose(flown[..., :3], states[:, :, t + 1, :3], atol=2e-2)
    np.testing.assert_allclose(flown[..., :3], given["goal"][..., :3], atol=2e-2)
    np.testing.assert_allclose(flown[..., 3:], given["goal"][..., 3:], atol=2e-5)


def test_the_card_says_what_goes_in_what_comes_out_and_what_was_measured(
    folder: Path, ff1: Model, dataset: DatasetInfo
) -> None:
    (folder / "figures").mkdir()
    measured = {
        n: {"exp2_flown_trials": trials, "exp2_flown_safe_share": safe}
        for n, trials, safe in ((3, 1000, 0.75), (30, 2, 0.125))
    }
    of_others = {n: {"exp2_flown_trials": 7, "exp2_flown_safe_share": 0.5} for n in (3, 10)}
    for digest, values in (("1234abcd" * 8, of_others), (dataset.digest, measured)):
        used = ("data/paper", digest)
        add_model_results(resolve("ff1"), values, folder / "figures", dataset=used)

    export("ff1", "--out", "x.onnx")

    card = (folder / "x.onnx.md").read_text(encoding="utf-8")
    rows = [re.findall(r"[^| ]+", line) for line in card.splitlines() if line.startswith("|")]
    assert ["3", "1000", "0.75"] in rows and ["30", "2", "0.125"] in rows
    assert ["10", "7", "0.5"] not in rows  # of other data
    assert f"on the dataset whose digest begins with `{dataset.digest[:36]}`" in card
    assert "apart: the share of unsafe plans is above. Check" in card
    assert "(safe: the plan keeps all limits of thrust, and no pair comes within" in card
    for word in ("m/s", "LVLH", "(batch, n, 6)", dataset.digest, "models:/prolearn-ff1/1"):
        assert word in card
    (kept,) = [p.value for p in onnx.load(folder / "x.onnx").metadata_props if p.key == "prolearn"]
    about = json.loads(kept)
    assert (about["schema"], about["arch"], about["nodes"]) == ("prolearn.onnx/1", "ff1", 6)


def test_a_file_that_does_not_answer_as_torch_is_not_written(
    folder: Path, ff1: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipeline.networks.onnx_export.TOLERANCE", 1e-12)
    done = CliRunner().invoke(app, ["models", "export", "ff1", "--out", "x.onnx"])
    assert done.exit_code == 1
    assert "differs from torch's" in done.output
    assert list(folder.glob("*onnx*")) == []


def test_what_torch_cannot_trace_is_said_in_words():
    class Branching(torch.nn.Module):
        def forward(self, x):
            return x if x.sum() > 0 else -x

    wanted = r"'mine' cannot be exported \([ -~]*data-dependent[ -~]*\); expected a forward pass"
    with pytest.raises(ProlearnError, match=wanted):
        traced(Branching(), {"x": torch.ones(3)}, ["y"], [{}], "mine")
