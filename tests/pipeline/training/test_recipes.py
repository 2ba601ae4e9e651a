"""Recipes and devices."""

from dataclasses import replace

import pytest
import torch

from pipeline.errors import InputError
from pipeline.training.device import training_device
from pipeline.training.recipes import RECIPES, recipe_for

NAMES = ("ff1", "ff2", "ffcol", "lstm1", "lstm2", "lstmcol")


@pytest.mark.parametrize("arch", NAMES)
def test_the_paper_s_recipe_is_the_paper_s(arch):
    recipe = recipe_for(arch, "paper")
    assert (recipe.name, recipe.target, recipe.dropout) == ("paper", "states", 0.5)
    assert (recipe.interior, recipe.patience) == ("line", 5)


@pytest.mark.parametrize("arch", NAMES)
def test_the_tuned_recipe_learns_offsets_without_dropout(arch):
    recipe = recipe_for(arch, "tuned")
    assert (recipe.name, recipe.target, recipe.dropout) == ("tuned", "offset", 0.0)


def test_unknown_names_are_refused_with_the_known_ones():
    with pytest.raises(InputError, match=r"'best'.*paper, tuned"):
        recipe_for("ff1", "best")
    with pytest.raises(InputError, match=r"'ff9'.*ff1"):
        recipe_for("ff9", "paper")


@pytest.mark.parametrize(
    "change",
    [
        {"batch_size": 0},
        {"epochs": 0},
        {"patience": 0},
        {"dropout": 1.0},
        {"dropout": -0.1},
        {"learning_rate": 0.0},
        {"learning_rate": float("nan")},
        {"collision_weight": -1.0},
        {"collision_weight": float("nan")},
    ],
    ids=str,
)
def test_numbers_that_nothing_can_be_trained_with_are_refused_by_name(change):
    with pytest.raises(InputError, match=next(iter(change))):
        replace(RECIPES["paper"], **change)


def test_devices_are_found_by_name():
    assert training_device("cpu").type == "cpu"
    assert training_device("auto").type == ("cuda" if torch.cuda.is_available() else "cpu")


@pytest.mark.parametrize("name", ["gpu", "", "meta", "cuda:99", "cpu:x"])
def test_a_device_that_is_not_there_is_refused(name):
    with pytest.raises(InputError, match="expected auto"):
        training_device(name)
