"""The six architectures against Table 1, counted by hand."""

import subprocess
import sys
from dataclasses import replace
from importlib.metadata import EntryPoint

import pytest
import torch
from torch import nn

from pipeline.errors import InputError, ProlearnError
from pipeline.networks import architecture
from pipeline.networks.architecture import find, recipe_for
from pipeline.networks.encoding import Encoding
from pipeline.networks.recipes import architecture_names
from pipeline.orbit.problem import Problem

NAMES = ("ff1", "ff2", "ffcol", "lstm1", "lstm2", "lstmcol")
IN = 6 * 10 * 11  # numbers in the paper's 6 x 110 matrix


def encoding(n=10, target="states"):
    return Encoding(Problem(), n, "line", target, (1.0,) * 6, (1.0,) * 6)


def dense(before, after):
    return before * after + after


def recurrent(before, units):
    """Four gates, each with weights for input and state; PyTorch has a bias for either."""
    return 4 * (before * units + units * units + 2 * units)


WEIGHTS = {
    "ff1": dense(IN, 180) + dense(180, IN),
    "ff2": dense(IN, 180) + dense(180, 150) + dense(150, IN),
    "ffcol": dense(IN, 180) + dense(180, IN),
    "lstm1": recurrent(6, 180) + dense(180, 6),
    "lstm2": recurrent(6, 180) + recurrent(180, 150) + dense(150, 6),
    "lstmcol": recurrent(6, 180) + dense(180, 6),
}


def test_the_paper_s_six_architectures_are_installed():
    assert set(NAMES) <= set(architecture_names())


@pytest.mark.parametrize("name", NAMES)
def test_each_architecture_has_the_weights_of_table_1(name):
    found = find(name)
    network = found.network(found.config, encoding(), 0.5)
    assert sum(p.numel() for p in network.parameters()) == WEIGHTS[name]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("n", [1, 4, 10, 11, 30])
def test_each_architecture_answers_swarms_of_any_size(name, n):
    found = find(name)
    network = found.network(found.config, encoding(), 0.0).eval()
    answer = found.forward(network, torch.randn(2, n, 11, 6), encoding())
    assert answer.shape == (2, n, 11, 6)
    assert torch.isfinite(answer).all()


@pytest.mark.parametrize(("name", "layers"), [("ff1", 1), ("ff2", 2), ("lstm1", 1), ("lstm2", 2)])
def test_dropout_follows_every_hidden_layer(name, layers):
    found = find(name)
    network = found.network(found.config, encoding(), 0.5)
    calls = []
    for module in network.modules():
        if isinstance(module, nn.Dropout):
            assert module.p == 0.5
            module.register_forward_hook(lambda *_: calls.append(1))
    found.forward(network, torch.randn(1, 10, 11, 6), encoding())
    assert len(calls) == layers


def test_a_feed_forward_answer_may_depend_on_all_craft_and_an_lstm_s_on_earlier_ones_only():
    inputs = torch.randn(1, 10, 11, 6)
    changed = inputs.clone()
    changed[0, 9] += 1.0  # the last craft
    for name, reacts in (("ff1", True), ("lstm1", False)):
        found = find(name)
        network = found.network(found.config, encoding(), 0.0).eval()
        first = found.forward(network, inputs, encoding())[0, 0]
        second = found.forward(network, changed, encoding())[0, 0]
        assert bool((first != second).any()) is reacts


@pytest.mark.parametrize("name", NAMES)
def test_only_the_collision_networks_pay_for_predicted_collisions(name):
    found = find(name)
    network = found.network(found.config, encoding(), 0.0)
    one_place = torch.zeros(1, 10, 11, 6)
    batch = {"inputs": one_place, "target": one_place}
    recipe = recipe_for(name, "tuned")
    plain = found.loss(network, batch, encoding(), replace(recipe, collision_weight=0.0))
    weighted = found.loss(network, batch, encoding(), replace(recipe, collision_weight=2.0))
    assert bool(weighted > plain) is name.endswith("col")


def test_an_unknown_architecture_is_refused_with_the_known_names():
    with pytest.raises(InputError, match=r"'ff9'.*ff1, ff2, ffcol, lstm1, lstm2, lstmcol"):
        find("ff9")


def test_an_entry_point_that_leads_nowhere_is_reported(monkeypatch):
    gone = EntryPoint("mine", "pipeline.networks.nowhere:MINE", "prolearn.architectures")
    monkeypatch.setattr(architecture, "entry_point", lambda name: gone)
    with pytest.raises(ProlearnError, match=r"pipeline\.networks\.nowhere"):
        find("mine")


def test_an_entry_point_to_something_else_is_refused(monkeypatch):
    other = EntryPoint("mine", "pipeline.orbit.problem:Problem", "prolearn.architectures")
    monkeypatch.setattr(architecture, "entry_point", lambda name: other)
    with pytest.raises(InputError, match="lacks members"):
        find("mine")


def test_names_are_listed_without_importing_torch():
    code = (
        "import sys; from pipeline.networks.recipes import architecture_names; "
        "assert 'ff1' in architecture_names(); assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


NO_SIZES = ([], [0], [-3], ["180"], [2.5], [True], "180", None, [10**9])


@pytest.mark.parametrize("name", ["ff1", "lstm1"])
@pytest.mark.parametrize("hidden", NO_SIZES, ids=str)
def test_sizes_that_make_no_network_are_refused(name, hidden):
    with pytest.raises(ValueError, match="hidden"):
        find(name).network({"hidden": hidden}, encoding(), 0.0)
