"""Parts of the refiner that are left out: they change no answer, and training keeps them out."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.dataset.examples import Examples
from pipeline.networks.architecture import find, recipe_for
from pipeline.networks.encoding import Encoding
from pipeline.networks.model import Model, load, save
from pipeline.networks.recipes import NO_THIRD, UNCROWDED
from pipeline.orbit.problem import Problem
from pipeline.scenario import draw
from pipeline.training.loop import train

PROBLEM = Problem()
REFINER = find("refiner")
SIZES = {**REFINER.config, "rounds": 3}
ENCODING = Encoding(PROBLEM, 10, "line", "offset", (1.0,) * 6, (1.0,) * 6)


def ends(n, count, family="dense"):
    drawn = [draw(family, 0, n, k, PROBLEM, "valid") for k in range(count)]
    return np.stack([s.initial for s in drawn]), np.stack([s.goal for s in drawn])


INITIAL, GOAL = ends(8, 4)


def network():
    """A network that has learned something at random, so that it bargains in earnest."""
    torch.manual_seed(0)
    made = REFINER.network(SIZES, ENCODING, 0.0)
    torch.nn.init.normal_(made.offer.weight, std=0.2)
    return made


def answer(made):
    return Model("refiner", SIZES, "tuned", ENCODING, made).answer(INITIAL, GOAL, 15.0)


def changed(made):
    """The same network with other weights of what sides tell of a craft's other encounters."""
    with torch.no_grad():
        made.tell.weight += 0.3
        made.tell.bias += 0.3
    return made


def test_what_third_sides_say_counts_until_it_is_left_out():
    assert not np.array_equal(answer(changed(network())), answer(network()))
    lacking = [network(), changed(network())]
    for made in lacking:
        made.hears.fill_(0)
    assert np.array_equal(*map(answer, lacking))
    assert not np.array_equal(answer(lacking[0]), answer(network()))


def test_what_is_left_out_is_stored_with_the_weights(tmp_path):
    made = network()
    made.hears.fill_(0)
    before = answer(made)
    save(Model("refiner", SIZES, "tuned", ENCODING, made), tmp_path)
    again = load(tmp_path)
    assert again.network.hears == 0
    assert np.array_equal(again.answer(INITIAL, GOAL, 15.0), before)


@pytest.mark.parametrize("averaging", [0.0, 0.9])
def test_training_leaves_a_part_out_of_what_is_scored_and_kept(averaging):
    data, held = (Examples(PROBLEM, INITIAL[k], GOAL[k]) for k in (slice(3), slice(3, 4)))
    recipe = replace(recipe_for("refiner", "no-third"), averaging=averaging, batch_size=2)
    found = train("refiner", recipe, data, held, device="cpu", epochs=1).model
    assert found.network.hears == 0
    assert found.network.offer.weight.any(), "something was learned"
    before = found.answer(INITIAL, GOAL, 15.0)
    changed(found.network)
    assert np.array_equal(found.answer(INITIAL, GOAL, 15.0), before)


def test_an_ablation_is_the_short_recipe_but_for_one_option():
    tuned, short = recipe_for("refiner", "tuned"), recipe_for("refiner", "short")
    assert replace(short, name="tuned", epochs=tuned.epochs) == tuned
    assert short.epochs < tuned.epochs
    lacking = []
    for name in (NO_THIRD, UNCROWDED):
        recipe = recipe_for("refiner", name)
        crowded = 0 if name == "uncrowded" else short.crowded  # neither kind of crowd to learn from
        assert replace(short, name=name, options=recipe.options, crowded=crowded) == recipe
        ((option, value),) = ((k, v) for k, v in recipe.options.items() if v != short.options[k])
        lacking.append((name, option, value))
    assert lacking == [
        ("no-third", "third", False),
        ("uncrowded", "raised", False),
    ]
