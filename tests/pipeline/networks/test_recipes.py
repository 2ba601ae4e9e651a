"""Recipes, by what training under them does, and devices."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from pipeline.dataset.examples import Examples
from pipeline.errors import InputError
from pipeline.networks.architecture import recipe_for
from pipeline.networks.device import torch_device
from pipeline.networks.recipes import RECIPES
from pipeline.orbit.problem import Problem
from pipeline.training.loop import train

HIDDEN = {
    "ff1": [180],
    "ff2": [180, 150],
    "ffcol": [180],
    "lstm1": [180],
    "lstm2": [180, 150],
    "lstmcol": [180],
}
"""Neurons of each hidden layer, from the paper's table "Neural Network Model Parameters"."""

PROBLEM = Problem(nodes=4)


def examples(count, seed):
    """Trajectories of no kind in particular, with components of different sizes."""
    rng = np.random.default_rng(seed)
    states = rng.normal(size=(count, 2, 4, 6)) * [100, 200, 50, 0.1, 0.2, 0.05]
    return Examples(PROBLEM, states[:, :, 0], states[:, :, -1], states)


TRAIN, VALID = examples(40, 0), examples(10, 1)


def run(arch, name, *, epochs=1, **changes):
    recipe = replace(recipe_for(arch, name), epochs=epochs, **changes)
    return train(arch, recipe, TRAIN, VALID, device="cpu")


def straight(data):
    """Node states on the straight line between both ends."""
    share = np.array([0, 1 / 3, 2 / 3, 1])[:, None]
    return (1 - share) * data.initial[:, :, None] + share * data.goal[:, :, None]


def sizes(states):
    """Root mean square of each component."""
    return np.sqrt(np.square(states).mean(axis=(0, 1, 2)))


@contextmanager
def watched():
    """Widths of all layers that drop while a network is trained, and the share that they drop."""
    found = []

    def watch(module, given, answer):
        if isinstance(module, nn.Dropout) and module.training:
            there = given[0] != 0
            found.append((given[0].shape[-1], float((answer[there] == 0).float().mean())))

    hook = nn.modules.module.register_module_forward_hook(watch)
    try:
        yield found
    finally:
        hook.remove()


@pytest.mark.parametrize("arch", list(HIDDEN))
def test_in_training_the_paper_s_recipe_drops_half_of_every_hidden_layer(arch):
    """ "Dropout regularization rate of 0.5 was used" after each hidden layer, feed-forward or LSTM
    (the paper's sections on learning and on experiment 1).
    """
    with watched() as layers:
        run(arch, "paper")
    batches = len(layers) // len(HIDDEN[arch])
    assert [width for width, _ in layers] == HIDDEN[arch] * batches
    layers, batches = (
        layers[len(HIDDEN[arch]) :],
        batches - 1,
    )  # the first warms up, on two examples
    assert batches > 0
    assert [share for _, share in layers] == pytest.approx([0.5] * len(layers), abs=0.05)


@pytest.mark.parametrize("arch", list(HIDDEN))
def test_in_training_the_tuned_recipe_drops_nothing(arch):
    with watched() as layers:
        run(arch, "tuned")
    assert all(share == 0 for _, share in layers)


def answers(model, bias):
    """What a model predicts for the validation data when its network answers a constant."""
    with torch.no_grad():
        for parameter in model.network.parameters():
            parameter.zero_()
        last = list(model.network.modules())[-1]
        assert isinstance(last, nn.Linear)
        last.bias.fill_(bias)
    return model.predict(VALID.initial, VALID.goal)


@pytest.mark.parametrize("arch", list(HIDDEN))
def test_the_paper_s_network_answers_trajectories_with_metres_and_metres_a_second_as_they_stand(
    arch,
):
    """ "Our input and output data consists of n spacecraft trajectories": an answer of 0 is a
    trajectory of zeros, and one unit of it is as many m as m/s.
    """
    model = run(arch, "paper").model
    assert (answers(model, 0.0) == 0).all()
    unit = sizes(TRAIN.states).max()
    np.testing.assert_allclose(answers(model, 1.0), unit, rtol=1e-6)


@pytest.mark.parametrize("arch", list(HIDDEN))
def test_the_tuned_network_answers_offsets_from_the_straight_line_each_component_in_its_own_size(
    arch,
):
    model = run(arch, "tuned").model
    np.testing.assert_allclose(answers(model, 0.0), straight(VALID), rtol=1e-6, atol=1e-9)
    unit = sizes(TRAIN.states - straight(TRAIN))
    offset = answers(model, 1.0) - straight(VALID)
    np.testing.assert_allclose(offset, np.broadcast_to(unit, offset.shape), rtol=1e-6)


@pytest.mark.parametrize("name", ["paper", "tuned"])
@pytest.mark.parametrize("arch", ["ff1", "lstm1"])
def test_a_network_reads_the_straight_line_between_both_ends(arch, name):
    model = run(arch, name).model
    read = []
    model.network.register_forward_pre_hook(lambda module, given: read.append(given[0]))
    model.predict(VALID.initial, VALID.goal)
    line = sizes(straight(TRAIN))
    unit = line.max() if name == "paper" else line
    given = torch.cat(read).numpy().reshape(VALID.states.shape)
    np.testing.assert_allclose(given * unit, straight(VALID), rtol=1e-5)


@pytest.mark.parametrize("arch", ["ff1", "lstm1"])
def test_under_the_paper_s_recipe_training_ends_after_five_epochs_without_a_better_one(arch):
    """ "We used a 'ValidationPatience' of 5" (the paper's section on experiment 1)."""
    # At so large a rate the validation loss soon rises for good.
    trained = run(arch, "paper", epochs=200, learning_rate=0.05, batch_size=8)
    losses = [epoch.valid_loss for epoch in trained.history]
    assert trained.best_epoch == 1 + int(np.argmin(losses))
    assert len(losses) == trained.best_epoch + 5


class Own:
    """An architecture of which only the recipes matter."""

    def __init__(self, **recipes):
        self.recipes = recipes


def test_an_architecture_adds_recipes_of_its_own_to_the_known_ones(monkeypatch):
    own = Own(long={"epochs": 7, "options": {"rounds": 6}}, paper={"dropout": 0.25})
    monkeypatch.setattr("pipeline.networks.architecture.find", lambda arch: own)
    long = recipe_for("mine", "long")
    assert long == replace(RECIPES["tuned"], name="long", epochs=7, options={"rounds": 6})
    assert recipe_for("mine", "paper") == replace(RECIPES["paper"], dropout=0.25)
    with pytest.raises(InputError, match=r"'best'.*paper or tuned or long"):
        recipe_for("mine", "best")


@pytest.mark.parametrize("fields", [{"rate": 1}, {"epochs": "7"}], ids=str)
def test_a_recipe_of_an_architecture_that_cannot_be_followed_is_refused(monkeypatch, fields):
    monkeypatch.setattr("pipeline.networks.architecture.find", lambda arch: Own(long=fields))
    with pytest.raises(InputError, match=r"'long' of architecture 'mine' cannot be followed"):
        recipe_for("mine", "long")


def test_unknown_names_are_refused_with_the_known_ones():
    with pytest.raises(InputError, match=r"'best'.*paper or tuned"):
        recipe_for("ff1", "best")
    with pytest.raises(InputError, match=r"'ff9'.*ff1"):
        recipe_for("ff9", "paper")


@pytest.mark.parametrize(
    "change",
    [
        {"batch_size": 0},
        {"batch_size": 32.5},
        {"epochs": 0},
        {"patience": 0},
        {"dropout": 1.0},
        {"dropout": -0.1},
        {"learning_rate": 0.0},
        {"learning_rate": float("nan")},
        {"collision_weight": -1.0},
        {"collision_weight": float("nan")},
        {"draws": -1},
        {"averaging": 1.0},
        {"gradient_limit": -1.0},
        {"gradient_limit": float("inf")},
        {"schedule": "step"},
    ],
    ids=str,
)
@pytest.mark.untyped
def test_numbers_that_nothing_can_be_trained_with_are_refused_by_name(change):
    with pytest.raises(InputError, match=next(iter(change))):
        replace(RECIPES["paper"], **change)


def test_devices_are_found_by_name():
    assert torch_device("cpu").type == "cpu"
    assert torch_device("auto").type == ("cuda" if torch.cuda.is_available() else "cpu")


@pytest.mark.parametrize("name", ["gpu", "", "meta", "cuda:99", "cpu:x"])
def test_a_device_that_is_not_there_is_refused(name):
    with pytest.raises(InputError, match="expected cpu, or cuda"):
        torch_device(name)
