"""Trained models in memory and in folders."""

import hashlib
import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import load as tensors_from
from safetensors.torch import save as tensors_to

from pipeline.errors import InputError
from pipeline.networks.architecture import find
from pipeline.networks.document import COLUMNS_AT_ONCE
from pipeline.networks.encoding import Encoding
from pipeline.networks.model import Model, load, save
from pipeline.networks.onnx_export import export
from pipeline.networks.refiner.model import FOLDER
from pipeline.orbit.problem import Problem

PROBLEM = Problem(nodes=4)
SCALE = (100.0, 200.0, 50.0, 0.1, 0.2, 0.05)


def untrained(name, n=3, target="states"):
    torch.manual_seed(0)
    encoding = Encoding(PROBLEM, n, "line", target, SCALE, SCALE)
    found = find(name)
    return Model(name, found.config, "paper", encoding, found.network(found.config, encoding, 0.5))


def ends(count, n):
    rng = np.random.default_rng(1)
    return rng.normal(size=(2, count, n, 6)) * np.array(SCALE)


@pytest.fixture
def folder(tmp_path):
    save(untrained("ff1"), tmp_path)
    return tmp_path


def forge(folder, weights):
    """Puts weights in place of the saved ones, with the digest that goes with them."""
    (folder / "weights.safetensors").write_bytes(weights)
    change(folder, weights_sha256=hashlib.sha256(weights).hexdigest())


def change(folder, **fields):
    """Another model.json, without a checksum as earlier versions wrote it."""
    path = folder / "model.json"
    written = json.loads(path.read_text())
    written.pop("checksum", None)
    path.write_text(json.dumps({**written, **fields}))


@pytest.mark.parametrize("name", ["ff2", "lstm2"])
def test_a_model_that_was_saved_predicts_as_before(name, tmp_path):
    model = untrained(name, target="offset")
    save(model, tmp_path / "deep" / "folder")
    again = load(tmp_path / "deep" / "folder")
    assert (again.architecture, again.recipe, again.encoding) == (name, "paper", model.encoding)
    for n in (1, 3, 5):
        assert np.array_equal(model.predict(*ends(2, n)), again.predict(*ends(2, n)))


def test_a_folder_holds_nothing_but_plain_weights_and_json(folder):
    assert {p.name for p in folder.iterdir()} == {"weights.safetensors", "model.json"}
    document = json.loads((folder / "model.json").read_text())
    assert document["schema"] == "prolearn.model/1"
    assert document["config"] == {"hidden": [180]}


def test_predictions_are_states_in_float64_without_dropout():
    model = untrained("ff1")
    first, second = model.predict(*ends(4, 3)), model.predict(*ends(4, 3))
    assert first.shape == (4, 3, 4, 6)
    assert first.dtype == np.float64
    assert np.array_equal(first, second)
    assert model.predict(*ends(0, 3)).shape == (0, 3, 4, 6)


def test_a_network_that_answers_zero_predicts_what_its_target_is_measured_from():
    for target in ("states", "offset"):
        model = untrained("ff1", target=target)
        for parameter in model.network.parameters():
            parameter.zero_()
        initial, goal = ends(2, 3)
        share = np.linspace(0, 1, 4)[:, None]
        line = initial[:, :, None] * (1 - share) + goal[:, :, None] * share
        expected = line if target == "offset" else 0 * line
        np.testing.assert_allclose(model.predict(initial, goal), expected, atol=1e-9)


def test_many_instances_are_predicted_as_one_by_one():
    model = untrained("lstm1", n=2)
    count = COLUMNS_AT_ONCE // (2 * PROBLEM.nodes) + 3  # more than fit in one part
    initial, goal = ends(count, 2)
    states = model.predict(initial, goal)
    for k in (0, count - 4, count - 3, count - 1):
        alone = model.predict(initial[k : k + 1], goal[k : k + 1])[0]
        np.testing.assert_allclose(states[k], alone, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("target", ["states", "offset"])
def test_an_lstm_on_another_time_grid_answers_what_its_module_says_to_the_longer_sequence(target):
    model = untrained("lstm1", target=target)
    moved = model.on(replace(PROBLEM, nodes=7, time_step=90.0))
    initial, goal = ends(2, 3)
    share = np.linspace(0, 1, 7)[:, None]
    line = initial[:, :, None] * (1 - share) + goal[:, :, None] * share  # (2, 3, 7, 6)
    columns = torch.from_numpy((line / SCALE).reshape(2, 21, 6)).float()
    answer = model.network(columns).double().numpy().reshape(2, 3, 7, 6) * SCALE
    expected = answer + line if target == "offset" else answer
    np.testing.assert_allclose(moved.predict(initial, goal), expected, rtol=1e-6, atol=1e-6)
    assert (moved.problem.nodes, moved.problem.time_step) == (7, 90.0)
    assert model.predict(initial, goal).shape == (2, 3, 4, 6)  # the first is as it was


@pytest.mark.parametrize("name", ["ff1", "ff2", "ffcol"])
def test_a_feed_forward_network_fits_other_steps_and_orbits_but_one_number_of_nodes(name):
    model = untrained(name)
    elsewhere = model.on(replace(PROBLEM, time_step=90.0, mean_motion=1e-3))
    assert np.array_equal(elsewhere.predict(*ends(2, 3)), model.predict(*ends(2, 3)))
    with pytest.raises(InputError, match=rf"{name}, trained with nodes 4 .* do not fit nodes 5 "):
        model.on(replace(PROBLEM, nodes=5))


def test_swarms_without_craft_are_refused():
    model = untrained("ff1")
    with pytest.raises(InputError, match="at least one"):
        model.predict(np.zeros((2, 0, 6)), np.zeros((2, 0, 6)))


@pytest.mark.parametrize("file", ["model.json", "weights.safetensors"])
def test_a_missing_file_is_reported(folder, file):
    (folder / file).unlink()
    with pytest.raises(InputError, match=file):
        load(folder)


@pytest.mark.parametrize("file", ["model.json", "weights.safetensors"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_a_truncated_file_is_reported(folder, file, share):
    content = (folder / file).read_bytes()
    (folder / file).write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError, match=file):
        load(folder)


def test_a_flipped_bit_in_the_weights_is_reported(folder):
    content = bytearray((folder / "weights.safetensors").read_bytes())
    content[-5] ^= 1
    (folder / "weights.safetensors").write_bytes(content)
    with pytest.raises(InputError, match="weights_sha256"):
        load(folder)


def flipped(content, bit):
    damaged = bytearray(content)
    damaged[bit // 8] ^= 1 << bit % 8
    return bytes(damaged)


@pytest.mark.parametrize("file", ["model.json", "weights.safetensors"])
def test_with_any_bit_flipped_a_model_is_refused_or_answers_the_same(folder, file):
    model, content = load(folder), (folder / file).read_bytes()
    drawn = np.random.default_rng(0).choice(8 * len(content), 300, replace=False)
    every = range(8 * len(content)) if file == "model.json" else map(int, drawn)
    expected = model.predict(*ends(2, 3))
    refused = 0
    for bit in every:
        (folder / file).write_bytes(flipped(content, bit))
        try:
            again = load(folder)
        except InputError:
            refused += 1
            continue
        assert np.array_equal(again.predict(*ends(2, 3)), expected), f"bit {bit}"
    assert refused > 200


def test_a_file_of_an_earlier_version_without_a_checksum_is_read(folder):
    expected = load(folder).predict(*ends(2, 3))
    change(folder)
    assert np.array_equal(load(folder).predict(*ends(2, 3)), expected)


def test_the_packaged_refiner_has_a_checksum_and_is_read():
    assert load(FOLDER).architecture == "refiner"
    assert json.loads((FOLDER / "model.json").read_text())["checksum"]


def test_truncated_weights_with_a_matching_digest_are_reported(folder):
    forge(folder, (folder / "weights.safetensors").read_bytes()[:-8])
    with pytest.raises(InputError, match="safetensors"):
        load(folder)


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"schema": "prolearn.model/2"}, "prolearn.model/2"),
        ({"schema": None}, "None"),
        ({"architecture": "ff9"}, "ff9"),
        ({"config": {"hidden": [90]}}, "expected"),
        ({"config": {"hidden": [-1]}}, "config"),
        ({"config": {"hidden": [10**9]}}, "config"),
        ({"config": {}}, "config"),
        ({"n_train": 4}, "expected"),
        ({"n_train": 0}, "n_train"),
        ({"n_train": "3"}, "n_train"),
        ({"interior": "arc"}, "arc"),
        ({"target": "controls"}, "controls"),
        ({"input_scale": [1.0] * 5}, "input_scale"),
        ({"input_scale": [1.0] * 5 + [0.0]}, "input_scale"),
        ({"target_scale": [1.0] * 5 + [float("nan")]}, "target_scale"),
        ({"problem": {"nodes": 4}}, "mean_motion"),
        ({"code": "print()"}, "code"),
    ],
    ids=str,
)
def test_a_wrong_field_is_refused_by_name(folder, fields, told):
    change(folder, **fields)
    with pytest.raises(InputError, match=told):
        load(folder)


@pytest.mark.parametrize("text", ["[]", "null", "{", "\x00", '{"schema": {}}'])
def test_a_document_that_is_none_is_refused(folder, text):
    (folder / "model.json").write_text(text)
    with pytest.raises(InputError, match=r"model\.json"):
        load(folder)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_weights_that_are_not_finite_are_refused(folder, value):
    weights = tensors_from((folder / "weights.safetensors").read_bytes())
    weights["0.bias"][7] = value
    forge(folder, tensors_to(weights))
    with pytest.raises(InputError, match=r"0\.bias.*finite"):
        load(folder)


def test_weights_of_other_shapes_names_or_types_are_refused(folder):
    weights = tensors_from((folder / "weights.safetensors").read_bytes())
    for other in (
        {**weights, "0.bias": weights["0.bias"][:-1].clone()},
        {**weights, "0.bias": weights["0.bias"].double()},
        {k: v for k, v in weights.items() if k != "0.bias"},
        {**weights, "extra": torch.zeros(1)},
    ):
        forge(folder, tensors_to(other))
        with pytest.raises(InputError, match=r"0\.bias|extra"):
            load(folder)


class Payload:
    def __init__(self, trace):
        self.trace = trace

    def __reduce__(self):
        return (open, (str(self.trace), "w"))


def test_a_pickle_in_place_of_the_weights_does_not_run(folder, tmp_path):
    trace = tmp_path / "ran"
    pickled = pickle.dumps(Payload(trace))
    forge(folder, pickled)
    with pytest.raises(InputError, match="safetensors"):
        load(folder)
    assert not trace.exists()
    pickle.loads(pickled).close()  # it would have
    assert trace.exists()


def test_loading_leaves_the_random_state_alone(folder):
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    load(folder)
    assert torch.equal(torch.rand(3), expected)


def test_a_network_that_answers_in_a_way_of_its_own_is_not_exported(gentle, tmp_path):
    with pytest.raises(InputError, match=r"'gentle' answers with controls .*Supervised"):
        export(untrained(gentle), tmp_path / "gentle.onnx")
    assert list(tmp_path.iterdir()) == []
