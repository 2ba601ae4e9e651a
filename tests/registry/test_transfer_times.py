"""Experiment 4 with registered networks, on the test split of a small dataset."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from pipeline.errors import InputError
from pipeline.training.loop import Trained
from pipeline.training.recipes import Recipe
from registry.jobs.evaluate import evaluate
from registry.jobs.transfer_times import transfer_times
from registry.results import Outcome, latest
from registry.store import EVALUATION, TRANSFER_TIMES
from registry.training import DatasetInfo, record_training

CRAFT = 3


@pytest.fixture
def registered(
    folder: Path, trained: Trained, trained_lstm: Trained, recipe: Recipe, dataset: DatasetInfo
) -> None:
    """A feed-forward network and an LSTM."""
    for one in (trained, trained_lstm):
        record_training(one, recipe=recipe, seed=0, dataset=dataset)


def test_lstms_take_part_at_every_time_and_feed_forward_networks_where_they_fit(
    registered: None, solved: Path
) -> None:
    said: list[str] = []
    asked: dict[str, Any] = {"n": CRAFT, "nodes": (6, 11), "time_steps": (60.0, 240.0)}
    done = transfer_times([], solved, **asked, trials=2, report=said.append)
    found = latest(TRANSFER_TIMES)
    assert done == Outcome(found.run_id)
    again = transfer_times([], solved, **asked, trials=2, resume=True)
    assert again == Outcome(found.run_id, earlier=True)
    assert (found.params["nodes"], found.params["time_steps"]) == ("6,11", "60,240")
    assert said[0] == "T = 6, Δt = 120 s"
    assert len(said) == 4
    table = found.table
    per = table.groupby(["planner", "reading"]).size()
    assert per["lstm1", "flown"] == per["lstm1", "predicted"] == per["expert", "plan"] == 4 * 2
    forward = table[(table.planner == "ff1") & (table.reading == "flown")]
    assert set(zip(forward.nodes, forward.time_step, strict=True)) == {
        (11, 120.0),
        (11, 60.0),
        (11, 240.0),
    }


def test_at_the_problem_of_the_training_networks_do_as_in_experiment_1(
    registered: None, solved: Path
) -> None:
    evaluate([], solved, sizes=(CRAFT,), trials=2, timed=0)
    transfer_times([], solved, n=CRAFT, nodes=(11,), time_steps=None, trials=2)
    home, table = latest(EVALUATION).table, latest(TRANSFER_TIMES).table
    for varied in ("nodes", "time_step"):
        rows = table[table.varied == varied][home.columns].reset_index(drop=True)
        pd.testing.assert_frame_equal(rows, home)


def test_networks_of_another_problem_than_the_dataset_are_refused(
    folder: Path, trained_lstm: Trained, recipe: Recipe, dataset: DatasetInfo, solved: Path
) -> None:
    elsewhere = trained_lstm.model.on(replace(trained_lstm.model.problem, time_step=90.0))
    record_training(replace(trained_lstm, model=elsewhere), recipe=recipe, seed=0, dataset=dataset)
    with pytest.raises(InputError, match=r"time_step 120 and the network lstm1 .* with 90;"):
        transfer_times([], solved, n=CRAFT, nodes=(11,), time_steps=None, trials=2)
