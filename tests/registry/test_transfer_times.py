"""Experiment 4 with registered networks, on the test split of a small dataset."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from judge import Case, Report, exact_step, fly, judge_plan, least_fuel
from judged import check_rows
from scipy.linalg import null_space

from cli.jobs import experiments
from cli.jobs.experiments import transfer_times
from cli.settings import TransferTimes
from pipeline.errors import InputError
from pipeline.parallel.workers import Workers
from pipeline.progress import Progress
from pipeline.training.loop import Trained
from registry.results import Recorded, latest, table_of
from registry.store import TRANSFER_TIMES
from registry.training import DatasetInfo, record_training

CRAFT, ALONE = 3, Workers(jobs=1)


class Notes(Progress):
    """Keeps what it is told of each transfer time."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def done(self, units: int = 1, note: str = "", *, failed: int = 0) -> None:
        self.notes.append(note)


@pytest.fixture
def registered(
    once: Callable[..., object],
    trained: Trained,
    trained_lstm: Trained,
    on_solved: DatasetInfo,
) -> None:
    """A feed-forward network and an LSTM."""

    def record() -> None:
        for one in (trained, trained_lstm):
            record_training(one, on_solved)

    once("ff1 and lstm1", record)


def test_lstms_take_part_at_every_time_and_feed_forward_networks_where_they_fit(
    registered: None, solved: Path
) -> None:
    told = Notes()
    asked = TransferTimes(data=str(solved), n=CRAFT, nodes="6,11", time_steps="60,120", trials=2)
    done = transfer_times(asked, workers=ALONE.with_progress(told))
    found = latest(TRANSFER_TIMES)
    assert done == Recorded(found.run_id)
    again = transfer_times(asked, resume=True)
    assert again == Recorded(found.run_id, earlier=True)
    assert (found.params["nodes"], found.params["time_steps"]) == ("6,11", "60,120")
    assert told.notes[0] == "T = 6, Δt = 240 s"
    assert len(told.notes) == 4 * 7 - 1, (
        "two experts, baselines and networks, but for ff1 at T = 11"
    )
    table = table_of(found)
    per = table.groupby(["planner", "reading"]).size()
    assert per["lstm1", "flown"] == per["lstm1", "predicted"] == per["expert", "plan"] == 4 * 2
    forward = table[(table.planner == "ff1") & (table.reading == "flown")]
    assert set(zip(forward.nodes, forward.time_step, strict=True)) == {
        (6, 240.0),
        (6, 60.0),
        (6, 120.0),
    }
    check_bounds(table, solved, 2)


def test_time_steps_that_hardly_differ_are_not_taken_for_the_same(
    registered: None, solved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = pd.DataFrame({"n": [CRAFT]})
    monkeypatch.setattr(experiments, "run_transfer_times", lambda *_, **__: table)
    asked = TransferTimes(data=str(solved), n=CRAFT, nodes="6", time_steps="60.1", trials=1)
    transfer_times(asked, workers=ALONE)
    assert transfer_times(asked, workers=ALONE, resume=True).earlier
    other = replace(asked, time_steps="60.100000001")
    assert not transfer_times(other, workers=ALONE, resume=True).earlier


def test_at_the_problem_of_the_training_networks_do_as_the_trained_ones_do(
    registered: None, trained: Trained, trained_lstm: Trained, solved: Path
) -> None:
    """What was trained predicts in memory; reading, flying and judging it is done anew here."""
    transfer_times(TransferTimes(data=str(solved), n=CRAFT, nodes="6", trials=2), workers=ALONE)
    table = table_of(latest(TRANSFER_TIMES))
    scenarios = rows_to_test(solved)[:2]
    initial, goal = (np.stack([s[end] for s in scenarios]) for end in ("initial", "goal"))
    check_bounds(table, solved, 2)
    for arch, model in (("ff1", trained.model), ("lstm1", trained_lstm.model)):
        predicted = model.predict(initial, goal)
        reports = [flown(*pair) for pair in zip(scenarios, predicted, strict=True)]
        for varied in ("nodes", "time_step"):
            rows = table[(table.varied == varied) & (table.planner == arch)]
            check_rows(rows[rows.reading == "flown"], reports)
            raw = rows[rows.reading == "predicted"]
            miss = np.abs(predicted[:, :, [0, -1]] - np.stack([initial, goal], axis=2))
            assert raw.boundary_error.to_numpy() == pytest.approx(miss[..., :3].max(axis=(1, 2, 3)))
            assert list(raw.node_collisions) == [close_nodes(states) for states in predicted]


def rows_to_test(solved: Path) -> list[dict[str, Any]]:
    """Scenarios of the test split as they stand in the Parquet files."""
    (file,) = solved.glob(f"n={CRAFT}/*.parquet")
    with pq.ParquetFile(file) as opened:
        about = json.loads(opened.schema_arrow.metadata[b"prolearn"])
        rows = opened.read().to_pylist()
    ends = ("initial", "goal")
    return [
        about | {end: np.reshape(row[end], (CRAFT, 6)) for end in ends}
        for row in rows
        if row["split"] == "test"
    ]


def check_bounds(table: pd.DataFrame, solved: Path, trials: int) -> None:
    """Every row's bound is HiGHS's, of its own trial, T and Δt."""
    scenarios = rows_to_test(solved)[:trials]
    bound = {}
    for nodes, step in set(zip(table.nodes, table.time_step, strict=True)):
        for trial, scenario in enumerate(scenarios):
            problem = replace(Case.of(scenario), nodes=int(nodes), step=step)
            found = least_fuel(problem, scenario["initial"], scenario["goal"])
            bound[nodes, step, trial] = found.proven.sum()
    wanted = [bound[key] for key in zip(table.nodes, table.time_step, table.trial, strict=True)]
    np.testing.assert_allclose(table.fuel_lower_bound, wanted, rtol=1e-6)


def flown(scenario: dict[str, Any], predicted: np.ndarray) -> Report:
    """The judge on the nearest trajectory with both ends that can be flown, by least squares."""
    problem = Case.of(scenario)
    free, forced = exact_step(problem.rate, problem.step)
    steps = problem.nodes - 1
    reach = np.zeros((problem.nodes, 6, 3 * steps))
    for t in range(1, problem.nodes):
        reach[t] = free @ reach[t - 1]
        reach[t, :, 3 * t - 3 : 3 * t] = forced
    weight = np.repeat([1.0, 1 / problem.rate], 3)
    drift = fly(problem, scenario["initial"], np.zeros((CRAFT, steps, 3)))
    end, whole = weight[:, None] * reach[-1], (weight[:, None] * reach).reshape(-1, 3 * steps)
    rest = null_space(end)  # pushes that change nothing at the end
    controls = []
    for k in range(CRAFT):
        push = np.linalg.lstsq(end, weight * (scenario["goal"][k] - drift[k, -1]), rcond=None)[0]
        off = (weight * (predicted[k] - drift[k] - reach @ push)).ravel()
        controls.append(push + rest @ np.linalg.lstsq(whole @ rest, off, rcond=None)[0])
    pushes = np.reshape(controls, (CRAFT, steps, 3))
    states = fly(problem, scenario["initial"], pushes)
    return judge_plan(scenario, {"states": states, "controls": pushes})


def close_nodes(states: np.ndarray) -> int:
    """Pairs and nodes within 15 m, counted one by one."""
    first, second = np.triu_indices(CRAFT, 1)
    apart = np.linalg.norm((states[first] - states[second])[..., :3], axis=-1)
    return int((apart <= 15.0).sum())


def test_networks_of_another_problem_than_the_dataset_are_refused(
    folder: Path, trained_lstm: Trained, on_solved: DatasetInfo, solved: Path
) -> None:
    elsewhere = trained_lstm.model.on(replace(trained_lstm.model.problem, time_step=90.0))
    record_training(replace(trained_lstm, model=elsewhere), on_solved)
    with pytest.raises(InputError, match=r"time_step 240 and the network lstm1 .* with 90;"):
        transfer_times(TransferTimes(data=str(solved), n=CRAFT, nodes="6", trials=2), workers=ALONE)
