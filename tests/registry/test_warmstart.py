"""Experiment 3 with a registered network, with either optimizer."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from cli.jobs.experiments import warmstart
from cli.settings import WarmStarts
from pipeline.errors import InputError
from pipeline.training.loop import Trained
from registry.results import Recorded, latest, table_of
from registry.store import WARMSTART
from registry.training import DatasetInfo

CRAFT = 3


@pytest.fixture
def registered(recorded: Callable[..., object], trained: Trained, on_solved: DatasetInfo) -> None:
    """A feed-forward network."""
    recorded(trained, on_solved)


def test_each_optimizer_has_runs_of_its_own_that_a_resume_finds(
    registered: None, solved: Path
) -> None:
    asked = WarmStarts(data=str(solved), sizes=f"{CRAFT}", trials=2)
    expert = warmstart(asked)
    plain = warmstart(replace(asked, optimizer="plain"), resume=True)
    assert plain.run_id != expert.run_id
    assert not plain.earlier
    for optimizer, done in (("expert", expert), ("plain", plain)):
        found = latest(WARMSTART, {"optimizer": optimizer})
        assert found.run_id == done.run_id
        assert found.params["optimizer"] == optimizer
        assert set(table_of(found).optimizer) == {optimizer}
        again = warmstart(replace(asked, optimizer=optimizer), resume=True)
        assert again == Recorded(done.run_id, earlier=True)
    assert latest(WARMSTART).run_id == plain.run_id
    more = warmstart(replace(asked, trials=3, optimizer="plain"), resume=True)
    assert not more.earlier


def test_an_optimizer_that_is_not_there_is_refused(registered: None, solved: Path) -> None:
    with pytest.raises(InputError, match="optimizer is 'magic'; expected expert or plain"):
        warmstart(WarmStarts(data=str(solved), sizes=f"{CRAFT}", optimizer="magic"))
