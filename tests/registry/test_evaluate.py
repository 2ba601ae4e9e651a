"""Experiments 1 and 2, interrupted and resumed."""

from pathlib import Path
from typing import Any

import pytest

import cli.jobs.experiments as job
from cli.settings import Evaluation
from pipeline.networks.recipes import Recipe
from pipeline.parallel.workers import Workers
from pipeline.training.loop import Trained
from registry.models import list_versions
from registry.training import DatasetInfo, record_training

CRAFT, ALONE = 3, Workers(jobs=1)


def test_an_evaluation_that_broke_off_among_the_models_is_not_done(
    folder: Path,
    trained: Trained,
    trained_lstm: Trained,
    recipe: Recipe,
    on_solved: DatasetInfo,
    solved: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for one in (trained, trained_lstm):
        record_training(one, recipe=recipe, seed=0, dataset=on_solved)
    asked = Evaluation(data=str(solved), sizes=f"{CRAFT}", trials=1, timed=0)
    add = job.add_to_model

    def first_only(network: Any, *rest: Any) -> None:
        if network.planner.name != "ff1":
            raise KeyboardInterrupt
        add(network, *rest)

    monkeypatch.setattr(job, "add_to_model", first_only)
    with pytest.raises(KeyboardInterrupt):
        job.evaluate(asked, workers=ALONE, resume=True)
    monkeypatch.setattr(job, "add_to_model", add)

    assert not job.evaluate(asked, workers=ALONE, resume=True).earlier
    assert all("exp1_flown_collisions" in version.metrics for version in list_versions())
    assert job.evaluate(asked, workers=ALONE, resume=True).earlier
