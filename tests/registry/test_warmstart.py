"""Experiment 3 with a registered network, with either optimizer."""

from pathlib import Path
from typing import Any

import pytest

from cli.stages.warmstart import warmstart
from pipeline.errors import InputError
from pipeline.networks.recipes import Recipe
from pipeline.training.loop import Trained
from registry.results import Done, latest, table_of
from registry.store import WARMSTART
from registry.training import DatasetInfo, record_training

CRAFT = 3


@pytest.fixture
def registered(folder: Path, trained: Trained, recipe: Recipe, on_solved: DatasetInfo) -> None:
    """A feed-forward network."""
    record_training(trained, recipe=recipe, seed=0, dataset=on_solved)


def test_each_optimizer_has_runs_of_its_own_that_a_resume_finds(
    registered: None, solved: Path
) -> None:
    asked: dict[str, Any] = {"sizes": (CRAFT,), "trials": 2}
    expert = warmstart([], solved, **asked)
    plain = warmstart([], solved, **asked, optimizer="plain", resume=True)
    assert plain.run_id != expert.run_id
    assert not plain.earlier
    for optimizer, done in (("expert", expert), ("plain", plain)):
        found = latest(WARMSTART, {"optimizer": optimizer})
        assert found.run_id == done.run_id
        assert found.params["optimizer"] == optimizer
        assert set(table_of(found).optimizer) == {optimizer}
        again = warmstart([], solved, **asked, optimizer=optimizer, resume=True)
        assert again == Done(done.run_id, earlier=True)
    assert latest(WARMSTART).run_id == plain.run_id
    more = warmstart([], solved, sizes=(CRAFT,), trials=3, optimizer="plain", resume=True)
    assert not more.earlier


def test_an_optimizer_that_is_not_there_is_refused(registered: None, solved: Path) -> None:
    with pytest.raises(InputError, match="optimizer is 'magic'; expected one of expert, plain"):
        warmstart([], solved, sizes=(CRAFT,), trials=1, optimizer="magic")
