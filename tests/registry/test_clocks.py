"""What was recorded last is the newest, also where the clock of its machine is ten days behind."""

from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from pipeline.training.loop import Trained
from registry.metrics import add_model_results, model_metrics_by_size
from registry.models import ModelVersion, resolve
from registry.results import earlier_run, evaluation, latest, record
from registry.store import EVALUATION, connect, recorded_run
from registry.training import DatasetInfo

TABLE = pd.DataFrame({"n": [1]})

CLOCK_BEHIND = """
import time
now = time.time
time.time = lambda: now() - 10 * 86400
"""

RECORDS = """
import pandas as pd
from registry.results import record
from registry.store import EVALUATION

record(EVALUATION, pd.DataFrame({"n": [2]}), params={"trials": 2})
"""

ADDS = """
from pathlib import Path
from registry.metrics import add_model_results
from registry.models import resolve

values = {0: {"exp1_flown_fuel": 0.5}, 10: {"exp2_flown_fuel": 0.25}}
add_model_results(resolve("ff1"), values, Path("figures"), dataset=("data", "d1"))
"""


def test_an_evaluation_just_made_counts_though_its_clock_is_behind(
    folder: Path, child: Callable[[str], int]
) -> None:
    first = record(EVALUATION, TABLE, params={"trials": 1})
    assert child(CLOCK_BEHIND + RECORDS) == 0
    second = evaluation()
    assert second.params == {"trials": "2"}
    assert second.created < evaluation(first).created
    assert earlier_run(EVALUATION, {"trials": 2}) == second.run_id
    assert earlier_run(EVALUATION, {"trials": 1}) is None
    assert evaluation(record(EVALUATION, TABLE, params={})) == evaluation()


def test_an_evaluation_with_its_clock_behind_gives_the_model_its_newest_metrics(
    folder: Path,
    child: Callable[[str], int],
    recorded: Callable[..., ModelVersion],
    trained: Trained,
    dataset: DatasetInfo,
) -> None:
    version = recorded(trained, dataset)
    (folder / "figures").mkdir()
    values = {0: {"exp1_flown_fuel": 1.0}, 10: {"exp2_flown_fuel": 2.0}}
    add_model_results(version, values, folder / "figures", dataset=("data", "d1"))
    assert child(CLOCK_BEHIND + ADDS) == 0
    assert resolve("ff1").metrics["exp1_flown_fuel"] == 0.5
    assert resolve("ff1").metrics["exp2_flown_fuel"] == 0.25
    assert model_metrics_by_size(version, ["exp2_flown_fuel"])[1] == {"exp2_flown_fuel": {10: 0.25}}


def test_runs_of_earlier_versions_which_have_no_number_are_older_and_ordered_by_their_clocks(
    folder: Path,
) -> None:
    store = connect()
    earlier = {}
    for start in (3000, 5000, 4000):
        run = store.client.create_run(store.experiments[EVALUATION], start_time=start)
        store.client.set_terminated(run.info.run_id)
        earlier[start] = run.info.run_id
    assert evaluation().run_id == earlier[5000]
    assert evaluation(record(EVALUATION, TABLE, params={})) == evaluation()


@pytest.mark.parametrize("number", ["next", "-3", "7", "1e9999999", "²" * 9, "9" * 30, ""])
def test_a_number_that_is_none_counts_as_none(folder: Path, number: str) -> None:
    first = record(EVALUATION, TABLE, params={})
    second = record(EVALUATION, TABLE, params={})
    connect().client.set_tag(first, "sequence", number)
    assert latest(EVALUATION).run_id == second
    assert evaluation(record(EVALUATION, TABLE, params={})) == evaluation()


def test_the_greatest_number_is_no_end(folder: Path) -> None:
    connect().client.set_tag(record(EVALUATION, TABLE, params={}), "sequence", "9" * 9)
    for _ in range(2):
        newest = record(EVALUATION, TABLE, params={})
        assert evaluation().run_id == newest


def test_the_newest_is_found_beside_many_runs_whose_numbers_are_none(folder: Path) -> None:
    store = connect()
    for k in range(25):  # more than are asked for at once, and first in the order of their tags
        run = store.client.create_run(store.experiments[EVALUATION], tags={"sequence": f"z{k}"})
        store.client.set_terminated(run.info.run_id)
    for _ in range(2):
        newest = record(EVALUATION, TABLE, params={"data": "it's"})
        assert evaluation().run_id == newest == latest(EVALUATION, {"data": "it's"}).run_id


def test_a_run_that_is_being_recorded_has_its_number_already(folder: Path) -> None:
    with recorded_run(connect(), EVALUATION, "other", {"sequence": "000000007"}):
        run_id = record(EVALUATION, TABLE, params={})
    assert evaluation(run_id).tags["sequence"] == "000000008"
