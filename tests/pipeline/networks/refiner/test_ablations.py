"""Parts of the refiner that are left out: they change no answer, and training keeps them out."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.dataset.examples import Examples
from pipeline.errors import InputError
from pipeline.networks.architecture import find, recipe_for, swarms
from pipeline.networks.encoding import Encoding
from pipeline.networks.model import Model, load, save
from pipeline.networks.recipes import LABELLED, NO_THIRD, UNCROWDED
from pipeline.networks.refiner.model import play, problem_data, start
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly
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
    for name in (NO_THIRD, UNCROWDED, LABELLED):
        recipe = recipe_for("refiner", name)
        crowded = 0 if name == "uncrowded" else short.crowded  # neither kind of crowd to learn from
        assert replace(short, name=name, options=recipe.options, crowded=crowded) == recipe
        ((option, value),) = ((k, v) for k, v in recipe.options.items() if v != short.options[k])
        lacking.append((name, option, value))
    assert lacking == [
        ("no-third", "third", False),
        ("uncrowded", "raised", False),
        ("labelled", "labels", 0.1),
    ]


def loss_with(labels, states, **options):
    """The loss of an untrained refiner on INITIAL and GOAL, by the average of its rounds."""
    given, recipe = swarms(PROBLEM, INITIAL, GOAL, states), recipe_for("refiner", "labelled")
    options = {**recipe.options, "labels": labels, "earlier": 1.0, **options}
    recipe = replace(recipe, options=options)
    torch.manual_seed(0)
    made = REFINER.network(SIZES, ENCODING, 0.0)
    torch.manual_seed(0)  # of how swarms are turned and crowded
    return REFINER.loss(made, REFINER.prepare(given, ENCODING), ENCODING, recipe).item()


def test_labels_cost_the_distance_from_the_expert_where_it_has_planned():
    """Against the node states of all rounds, flown by the problem's own dynamics."""
    torch.manual_seed(0)
    made = REFINER.network(SIZES, ENCODING, 0.0)
    rng, tuned = np.random.default_rng(0), recipe_for("refiner", "tuned").options["rounds"]
    plans = rng.normal(size=(4, 8, PROBLEM.nodes, 6)) * 100
    apart = 0.0
    for count in range(1, tuned + 1):
        data = problem_data(PROBLEM, INITIAL, GOAL, np.full(4, 15.0))
        state = start(data)
        for number in range(count):
            state = play(made.arrays, data, state, number)
        controls = state.controls * 15.0 / PROBLEM.time_step**2
        flown = fly(INITIAL, controls.reshape(4, 8, -1, 3), PROBLEM)
        apart += np.linalg.norm((flown - plans)[..., :3], axis=3).mean() / 15.0 / tuned
    found = loss_with(0.3, plans) - loss_with(1e-12, plans)
    assert found == pytest.approx(0.3 * apart, rel=1e-6)
    unraised = loss_with(0.3, plans, raised=False) - loss_with(1e-12, plans, raised=False)
    assert unraised == pytest.approx(found, rel=1e-6)  # whether others are raised or not
    half = plans.copy()
    half[::2] = np.nan
    assert np.isfinite(loss_with(0.3, half))


def test_scenarios_that_nobody_has_planned_have_no_labels():
    assert loss_with(0.3, None) == loss_with(1e-12, None)
    recipe = replace(recipe_for("refiner", "labelled"), draws=10)
    batch = REFINER.prepare(swarms(PROBLEM, INITIAL, GOAL), ENCODING)
    with pytest.raises(InputError, match=r"labels is 0.1 and draws 10, .* expected labels 0, or"):
        REFINER.loss(network(), batch, ENCODING, recipe)
