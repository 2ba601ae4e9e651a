"""The training loop on small data."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.dataset.examples import Examples
from pipeline.errors import InputError, ProlearnError
from pipeline.networks.architecture import find, recipe_for, unused_fields
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import node_collisions
from pipeline.orbit.transfer import fly, minimum_energy
from pipeline.progress import Progress
from pipeline.training import loop
from pipeline.training.loop import train

PROBLEM = Problem(nodes=4)


def examples(count, seed, n=2):
    """Minimum-energy transfers between random states of the size of the reference problem's."""
    rng = np.random.default_rng(seed)
    initial, goal = rng.normal(size=(2, count, n, 6)) * np.repeat([100.0, 0.1], 3)
    controls = minimum_energy(initial, goal, PROBLEM)
    return Examples(PROBLEM, initial, goal, fly(initial, controls, PROBLEM))


TRAIN, VALID = examples(120, 0), examples(30, 1)


def run(arch="ff1", recipe="paper", data=TRAIN, valid=VALID, *, seed=0, epochs=4, **changes):
    chosen = replace(recipe_for(arch, recipe), **{"batch_size": 16, "epochs": epochs, **changes})
    return train(arch, chosen, data, valid, seed=seed, device="cpu")


def weights(trained):
    return torch.cat([p.flatten() for p in trained.model.network.state_dict().values()])


def encoded_error(model, data):
    """Mean square error in encoded units, from the model's predictions in m and m/s."""
    error = model.predict(data.initial, data.goal) - data.states
    return np.square(error / np.array(model.encoding.target_scale)).mean()


@pytest.mark.parametrize("arch", ["ff1", "ff2", "lstm1", "lstm2"])
@pytest.mark.parametrize("recipe", ["paper", "tuned"])
def test_training_betters_the_untrained_network(arch, recipe):
    rate = 1e-2 if arch.startswith("lstm") else 2e-3
    untrained = run(arch, recipe, epochs=1, learning_rate=1e-12)
    trained = run(arch, recipe, epochs=4 if recipe == "paper" else 10, learning_rate=rate)
    before, after = (encoded_error(model, VALID) for model in (untrained.model, trained.model))
    assert after < 0.8 * before


def test_the_validation_loss_is_the_mean_square_error_without_dropout():
    trained = run(epochs=3)
    best = trained.history[trained.best_epoch - 1].valid_loss
    assert encoded_error(trained.model, VALID) == pytest.approx(best, rel=1e-4)


def test_the_weights_of_the_best_epoch_are_kept():
    # So large a rate that epochs after the best do harm.
    trained = run(epochs=40, learning_rate=0.05, dropout=0.0, patience=3)
    losses = [epoch.valid_loss for epoch in trained.history]
    assert trained.best_epoch == 1 + int(np.argmin(losses))
    assert trained.best_epoch < len(losses)
    assert encoded_error(trained.model, VALID) == pytest.approx(min(losses), rel=1e-4)


def test_training_ends_when_patience_does():
    trained = run(epochs=200, learning_rate=0.05, dropout=0.0, patience=3)
    assert len(trained.history) == trained.best_epoch + 3
    assert len(trained.history) < 200


class Told(Progress):
    """Keeps what it is told."""

    def __init__(self):
        self.expected, self.notes = [], []

    def expect(self, total):
        self.expected.append(total)

    def done(self, units=1, note="", *, failed=0):
        self.notes += [note] * units


def test_epochs_are_reported_as_they_end():
    told = Told()
    recipe = replace(recipe_for("ff1", "paper"), epochs=3)
    trained = train("ff1", recipe, TRAIN, VALID, seed=0, device="cpu", progress=told)
    assert told.expected == [3]
    assert told.notes == [f"loss {epoch.valid_loss:.4g}" for epoch in trained.history]
    assert [epoch.number for epoch in trained.history] == [1, 2, 3]
    assert 0 < sum(epoch.seconds for epoch in trained.history) < trained.seconds
    assert trained.device == "cpu"


@pytest.mark.parametrize("arch", ["ff2", "lstm2"])
def test_the_same_seed_gives_the_same_bits_and_another_seed_does_not(arch):
    torch.manual_seed(1)
    first = run(arch, seed=7, epochs=2)
    torch.manual_seed(2)
    second, other = run(arch, seed=7, epochs=2), run(arch, seed=8, epochs=2)
    assert torch.equal(weights(first), weights(second))
    assert [e.valid_loss for e in first.history] == [e.valid_loss for e in second.history]
    assert not torch.equal(weights(first), weights(other))


def test_training_leaves_the_random_state_alone():
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    run(epochs=1)
    assert torch.equal(torch.rand(3), expected)


def test_the_model_remembers_what_it_was_trained_on():
    model = run(recipe="tuned", epochs=1, interior="zeros").model
    assert (model.architecture, model.recipe) == ("ff1", "tuned")
    assert (model.problem, model.n_train) == (PROBLEM, 2)
    assert (model.encoding.interior, model.encoding.target) == ("zeros", "offset")


def test_scales_come_from_the_training_data_alone():
    far = replace(VALID, initial=1e3 * VALID.initial)
    assert run(epochs=1).model.encoding == run(valid=far, epochs=1).model.encoding


def test_a_collision_network_predicts_fewer_collisions_than_without_its_penalty():
    near = replace(PROBLEM, collision_radius=60.0)
    data, valid = replace(TRAIN, problem=near), replace(VALID, problem=near)

    def collisions(arch, weight):
        changes = {"collision_weight": weight, "dropout": 0.0, "epochs": 10}
        trained = run(arch, data=data, valid=valid, **changes)
        return node_collisions(trained.model.predict(data.initial, data.goal), 60.0).sum()

    without = collisions("ff1", 5.0)  # which has no penalty, whatever the weight
    assert without > 0
    assert collisions("ffcol", 0.0) == without
    assert collisions("ffcol", 5.0) < 0.5 * without


def test_examples_that_are_no_numbers_are_refused():
    spoilt = TRAIN.states.copy()
    spoilt[17, 1, 2, 3] = np.nan
    with pytest.raises(InputError, match="training example 17 has states"):
        run(data=replace(TRAIN, states=spoilt))
    goal = VALID.goal.copy()
    goal[2] = np.inf
    with pytest.raises(InputError, match="validation example 2 has goal"):
        run(valid=replace(VALID, goal=goal))


def test_empty_examples_are_refused():
    with pytest.raises(InputError, match="no training examples"):
        run(data=examples(0, 0))
    with pytest.raises(InputError, match="no validation examples"):
        run(valid=examples(0, 0))


def test_examples_of_two_swarm_sizes_or_problems_are_refused():
    with pytest.raises(InputError, match="n = 3"):
        run(valid=examples(5, 0, n=3))
    with pytest.raises(InputError, match="collision_radius=9"):
        run(valid=replace(VALID, problem=replace(PROBLEM, collision_radius=9.0)))


def test_wrong_settings_are_refused():
    with pytest.raises(InputError, match="epochs is 0"):
        run(epochs=0)
    with pytest.raises(InputError, match="'ff9'"):
        train("ff9", recipe_for("ff1", "paper"), TRAIN, VALID, device="cpu")
    with pytest.raises(InputError, match="'tpu'"):
        train("ff1", recipe_for("ff1", "paper"), TRAIN, VALID, device="tpu")


def test_a_loss_that_is_no_number_ends_the_run_with_advice():
    with pytest.raises(ProlearnError, match="lower the learning rate"):
        run(learning_rate=1e30, epochs=5)


OTHERWISE = {"collision_weight": 5.0, "dropout": 0.3, "interior": "zeros"}


@pytest.mark.parametrize("field", OTHERWISE)
@pytest.mark.parametrize("arch", ["ff1", "ff2", "ffcol", "lstm1", "lstm2", "lstmcol", "refiner"])
def test_fields_of_a_recipe_change_the_weights_unless_they_are_said_to_be_unused(arch, field):
    near = replace(PROBLEM, collision_radius=100.0)
    few, fewer = (replace(examples(*size), problem=near) for size in ((16, 0), (4, 1)))
    told = {"crowded": 0, "dropout": 0.0}
    plain = run(arch, "tuned", few, fewer, epochs=1, **told)
    other = run(arch, "tuned", few, fewer, epochs=1, **(told | {field: OTHERWISE[field]}))
    same = torch.equal(weights(plain), weights(other))
    assert same == (field in unused_fields(find(arch)))


def test_what_a_process_does_for_its_first_training_alone_is_not_of_the_seconds(monkeypatch):
    adam, now = loop._Adam, [0.0]

    def first(*args, **kwargs):  # takes seconds, as libraries of a GPU do
        now[0] += 5.0 * (now[0] == 0.0)
        return adam(*args, **kwargs)

    monkeypatch.setattr(loop.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(loop, "_Adam", first)
    assert run(epochs=2).seconds == 0.0
    assert now == [5.0]
