"""Ablations with registered refiners, on the test split of a small dataset."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch
from judged import check_rows, judged

from benchmarks.ablate import Ablations, ablate, dense_beside
from benchmarks.rule import with_rounds
from cli.jobs.experiments import HeldOut, evaluate
from cli.jobs.networks import networks
from cli.jobs.report import report
from cli.settings import Evaluation
from pipeline.dataset.reading import solved_rows
from pipeline.dataset.schema import scenarios_of
from pipeline.errors import InputError
from pipeline.networks.architecture import find, recipe_for
from pipeline.networks.model import Model
from pipeline.networks.recipes import NO_THIRD
from pipeline.orbit.problem import Problem
from pipeline.planners.network import NetworkPlanner
from pipeline.scenario import Scenario, draw
from pipeline.training.loop import Trained
from registry.results import Done, latest, table_of
from registry.store import ABLATIONS
from registry.training import DatasetInfo, record_training

CRAFT, ROUNDS = 3, find("refiner").config["rounds"]
TRIALS = 2
ASKED = Ablations(sizes=f"{CRAFT}", rounds="0,2", trials=TRIALS, dense=1, timed=1)

Register = Callable[..., Model]


@pytest.fixture
def register(folder: Path, trained: Trained, on_solved: DatasetInfo) -> Register:
    """Registers a refiner that has learned something at random, by its recipe."""

    def made(recipe: str, seed: int = 0, **sizes: int) -> Model:
        refiner = find("refiner")
        config = {**refiner.config, **sizes}
        torch.manual_seed(seed)
        network: Any = refiner.network(config, trained.model.encoding, 0.0)
        torch.nn.init.normal_(network.offer.weight, std=0.2)
        network.hears.fill_(float(recipe != NO_THIRD))
        model = Model("refiner", config, recipe, trained.model.encoding, network)
        followed = recipe_for("refiner", recipe)
        record_training(
            replace(trained, model=model), recipe=followed, seed=seed, dataset=on_solved
        )
        return model

    return made


def scenarios(solved: Path) -> list[Scenario]:
    """The first scenarios of the test split."""
    columns = ("scenario_id", "n_spacecraft", "family", "initial", "goal")
    return list(scenarios_of(solved_rows(solved, CRAFT, "test", columns)))[:TRIALS]


def test_refiners_the_rule_and_the_decoupled_optimum_are_tried_after_every_number_of_rounds(
    register: Register, solved: Path
) -> None:
    models = {recipe: register(recipe) for recipe in ("tuned", "short", "no-third")}
    done = ablate(replace(ASKED, data=str(solved)))
    found = latest(ABLATIONS)
    assert found is not None
    assert done == Done(found.run_id)
    assert (found.params["rounds"], found.params["sizes"]) == (f"0,2,{ROUNDS}", "3")
    table = table_of(found)
    counted = table.groupby(["planner", "recipe"])["rounds"].agg(lambda k: sorted(set(k)))
    assert dict(counted) == {
        ("decoupled optimum", ""): [0],
        ("rule", ""): [2, ROUNDS],
        ("refiner", "tuned"): [2, ROUNDS],
        ("refiner", "short"): [2, ROUNDS],
        ("refiner", "no-third"): [ROUNDS],
    }
    assert (table.own_rounds == ROUNDS).all()
    each = table.groupby(["family", "planner", "recipe", "rounds"])
    assert each["seconds"].count().eq(1).all()
    dense = draw("dense", 0, 10, 0, models["tuned"].problem, "test")
    tried = {("rings", CRAFT): scenarios(solved), ("dense", 10): [dense]}
    each = table[table.planner == "refiner"].groupby(["family", "n", "recipe", "rounds"])
    assert len(each) == 2 * 5
    for (family, n, recipe, rounds), rows in each:
        planner, asked = (
            NetworkPlanner(with_rounds(models[recipe], rounds), "refiner"),
            tried[family, n],
        )
        reports = [judged(s, plan) for s, plan in zip(asked, planner.plan(asked), strict=True)]
        check_rows(rows, reports)
    own = table[table.planner == "decoupled optimum"]
    np.testing.assert_allclose(own.fuel, own.fuel_lower_bound, rtol=1e-6)


def test_the_report_has_the_ablations_of_its_data_and_says_where_another_refiner_took_part(
    register: Register, solved: Path, folder: Path
) -> None:
    register("tuned")
    register("no-third")
    register("short")
    done = ablate(replace(ASKED, data=str(solved)))
    first = evaluate(Evaluation(data=str(solved), sizes=f"{CRAFT}", trials=2, timed=0))
    files = report(folder / "out")
    text = files.markdown.read_text()
    assert "| Is the refiner worse without messages of other encounters?" in text
    provenance = pd.read_csv(folder / "out" / "tables" / "provenance.csv").set_index("part")["run"]
    assert provenance["Ablations"] == done.run_id
    assert "Training refiner:no-third, seed 0" in provenance
    assert "took part there and not in this evaluation" not in text
    training = pd.read_csv(folder / "out" / "tables" / "training.csv")
    assert list(training["recipe"]) == ["tuned"], "ablations take part in no evaluation"
    register("tuned", seed=1)
    ablate(replace(ASKED, data=str(solved)))
    text = report(folder / "later", first.run_id).markdown.read_text()
    assert "Ablations: models:/prolearn-refiner/4 took part there and not in this" in text


def test_where_no_model_is_named_only_ablations_take_refiners_that_lack_something(
    register: Register, solved: Path
) -> None:
    for recipe in ("tuned", "short", "no-third", "uncrowded"):
        register(recipe)
    assert [network.version.recipe for network in networks([], solved)] == ["tuned"]
    named = networks(["refiner:no-third"], solved)
    assert [network.version.recipe for network in named] == ["no-third"]


def test_data_that_are_dense_themselves_are_joined_by_no_others() -> None:
    def beside(family: str) -> list[Scenario]:
        first = draw(family, 0, 3, 0, Problem(), "test")
        return dense_beside(HeldOut(Path("data"), "", {3: [first]}, []), 2)

    drawn = beside("rings")
    assert [(one.family, one.n) for one in drawn] == 2 * [("dense", 10)]
    assert drawn[0].name != drawn[1].name
    assert beside("dense") == []


def test_networks_of_other_kinds_and_refiners_of_other_rounds_are_refused(
    register: Register, trained: Trained, recipe: Any, on_solved: DatasetInfo, solved: Path
) -> None:
    record_training(trained, recipe=recipe, seed=0, dataset=on_solved)
    with pytest.raises(InputError, match=r"no refiner was trained on .*; expected some: `make abl"):
        ablate(replace(ASKED, data=str(solved)))
    with pytest.raises(InputError, match=r"rounds \(ff1 tuned none\); expected refiners"):
        ablate(replace(ASKED, data=str(solved), models="ff1:tuned"))
    register("tuned")
    register("short", rounds=5)
    with pytest.raises(InputError, match=rf"\(refiner short 5, refiner tuned {ROUNDS}\); expected"):
        ablate(replace(ASKED, data=str(solved)))
    with pytest.raises(InputError, match="timed is -1 and dense 1; expected 0 or more each"):
        ablate(replace(ASKED, data=str(solved), timed=-1))
