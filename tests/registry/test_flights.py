"""Experiment 5 with registered networks, on the test split of a small dataset."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from cli.jobs.experiments import evaluate, flights, transfer_times
from cli.jobs.report import report
from cli.settings import Evaluation, Flights, TransferTimes
from pipeline.dataset.making import sample
from pipeline.dataset.samples import Sample
from pipeline.errors import InputError
from pipeline.experiments.records import LINEAR, NO_ERRORS, OPEN, REPLANNED
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.parallel.workers import Workers
from pipeline.progress import SILENT, Progress
from pipeline.training.loop import Trained
from registry.results import Recorded, latest, table_of
from registry.store import FLIGHTS
from registry.training import DatasetInfo, record_training

CRAFT = 3


def fly(
    solved: Path, models: str | None = None, progress: Progress = SILENT, **options: Any
) -> Recorded:
    asked = Flights(models=models, data=str(solved), n=CRAFT, trials=1, flights=1)
    return flights(asked, workers=Workers(1, progress=progress), **options)


class Counts(Progress):
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.expected, self.count = 0, 0

    def expect(self, total: int) -> None:
        self.expected = total

    def done(self, units: int = 1, note: str = "", *, failed: int | None = None) -> None:
        self.count += units


@pytest.fixture
def registered(
    once: Callable[..., object],
    trained: Trained,
    trained_lstm: Trained,
    on_solved: DatasetInfo,
) -> None:
    """A feed-forward network and an LSTM, and no refiner."""

    def record() -> None:
        for one in (trained, trained_lstm):
            record_training(one, on_solved)

    once("ff1 and lstm1", record)


def test_a_network_that_was_named_is_made_safe_and_flies_beside_expert_and_baselines(
    registered: None, solved: Path, folder: Path
) -> None:
    told = Counts()
    done = fly(solved, "lstm1", progress=told)
    found = latest(FLIGHTS)
    assert found is not None
    assert done == Recorded(found.run_id)
    assert (told.expected, told.count) == (1, 1)
    assert fly(solved, "lstm1", resume=True) == Recorded(found.run_id, earlier=True)
    kept = {name: found.params[name] for name in ("n", "trials", "flights", "seed", "networks")}
    assert kept == {"n": "3", "trials": "1", "flights": "1", "seed": "0", "networks": "lstm1 tuned"}
    table = table_of(found)
    assert set(table.planner) == {"expert", "minimum energy", "decoupled optimum", "lstm1"}
    planned = table[(table.world == LINEAR) & (table.errors == NO_ERRORS)]
    safe = planned[planned.planner.isin(["expert", "lstm1"])]
    assert not safe.within_radius.any()
    assert set(safe.loop) == {OPEN, REPLANNED}

    asked = Evaluation(models="ff1", data=str(solved), sizes=f"{CRAFT}", trials=1, timed=0)
    evaluate(asked, workers=Workers(1))
    files = report(folder / "reports")
    text = files.markdown.read_text()
    assert "Plans of test scenarios, 1 of n = 3, are flown" in text
    assert "Experiment 5: models:/prolearn-lstm1/1 took part there and not in this" in text
    provenance = pd.read_csv(folder / "reports/tables/provenance.csv").set_index("part")["run"]
    assert provenance["Experiment 5"] == found.run_id


def test_networks_that_serve_one_number_of_nodes_are_refused(
    registered: None, solved: Path
) -> None:
    with pytest.raises(InputError, match=r"network ff1, .* do not fit nodes 4"):
        fly(solved, "ff1")


def test_without_a_refiner_expert_and_baselines_fly_alone(registered: None, solved: Path) -> None:
    fly(solved)
    found = latest(FLIGHTS)
    assert found is not None
    assert set(table_of(found).planner) == {"expert", "minimum energy", "decoupled optimum"}
    assert found.params["models"] == ""


@pytest.mark.parametrize(
    ("run", "settings", "why"),
    [(flights, Flights, "flights are"), (transfer_times, TransferTimes, "about others")],
)
def test_scenarios_about_an_orbit_of_their_own_are_refused(
    run: Callable[..., Recorded], settings: Callable[..., Any], why: str, folder: Path
) -> None:
    """They would be flown about other orbits, or end in formations that drift."""
    problem = Problem().about(ReferenceOrbit(7e6, 0.05, 50.0))
    sample(folder / "data", {CRAFT: Sample("rings", count=4)}, problem, workers=Workers(1))
    with pytest.raises(InputError, match=f"an orbit of their own; .* a circle, since {why}"):
        run(settings(data=str(folder / "data"), n=CRAFT))


@pytest.mark.parametrize("wrong", [{"flights": 0}, {"seed": -1}])
def test_numbers_that_are_refused_leave_nothing_behind(
    wrong: dict[str, int], solved: Path, folder: Path
) -> None:
    with pytest.raises(InputError, match=f"{next(iter(wrong))} is"):
        flights(Flights(data=str(solved), n=CRAFT, **wrong))
    assert [one.name for one in folder.iterdir()] == ["mlflow.db"]
