"""Experiments, interrupted and resumed, and with a device."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import torch
from short_transfer import PROBLEM

import cli.jobs.experiments as job
from cli.settings import Evaluation, TransferTimes, WarmStarts
from pipeline.dataset.making import sample, solve
from pipeline.dataset.samples import Sample
from pipeline.errors import InputError
from pipeline.expert import Settings
from pipeline.networks.architecture import find
from pipeline.networks.encoding import Encoding
from pipeline.networks.model import Model
from pipeline.networks.refiner import tensors
from pipeline.networks.refiner.model import packaged
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.parallel.workers import Workers
from pipeline.training.loop import Trained
from registry.metrics import model_metrics_by_size
from registry.models import list_versions
from registry.results import experiment_run, table_of
from registry.training import DatasetInfo

CRAFT, ALONE = 3, Workers(jobs=1)


def test_an_evaluation_that_broke_off_among_the_models_is_not_done(
    recorded: Callable[..., object],
    trained: Trained,
    trained_lstm: Trained,
    on_solved: DatasetInfo,
    solved: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for one in (trained, trained_lstm):
        recorded(one, on_solved)
    asked = Evaluation(data=str(solved), sizes=f"{CRAFT}", trials=1, timed=0)
    add = job.add_to_model

    def first_only(version: Any, *rest: Any) -> None:
        if version.arch != "ff1":
            raise KeyboardInterrupt
        add(version, *rest)

    monkeypatch.setattr(job, "add_to_model", first_only)
    with pytest.raises(KeyboardInterrupt):
        job.evaluate(asked, workers=ALONE, resume=True)
    monkeypatch.setattr(job, "add_to_model", add)

    assert not job.evaluate(asked, workers=ALONE, resume=True).earlier
    for version in list_versions():
        assert "exp1_flown_collisions" in version.metrics
        of_data, by_name = model_metrics_by_size(version, ["exp2_flown_trials"])
        assert (by_name["exp2_flown_trials"], of_data) == ({CRAFT: 1}, on_solved.digest[:36])
    assert job.evaluate(asked, workers=ALONE, resume=True).earlier


@pytest.mark.parametrize(
    "asked", [Evaluation(trials=3, timed=1), TransferTimes(n=CRAFT, nodes="6", trials=3)]
)
def test_with_a_device_the_refiner_plans_there_and_has_the_rows_of_compiled_code(
    recorded: Callable[..., object],
    trained: Trained,
    on_solved: DatasetInfo,
    solved: Path,
    monkeypatch: pytest.MonkeyPatch,
    asked: Evaluation | TransferTimes,
) -> None:
    recorded(trained, on_solved)
    run = job.evaluate if isinstance(asked, Evaluation) else job.transfer_times
    here, there = (replace(asked, data=str(solved), device=name) for name in (None, "cpu"))
    with pytest.raises(InputError, match="device is cpu and no refiner is among the models"):
        run(there, workers=ALONE)  # type: ignore[arg-type]

    given = packaged_weights(trained.model.encoding)
    recorded(replace(trained, model=given), on_solved)
    if run is job.evaluate:  # which draws figures of every network
        here, there = (replace(one, models="refiner") for one in (here, there))
    planned, numbers = [], []
    monkeypatch.setattr(tensors, "planned_on", spied(tensors.planned_on, planned))
    for one in (here, there):
        run_id = run(one, workers=ALONE).run_id  # type: ignore[arg-type]
        table = table_of(experiment_run(run_id)).drop(columns="seconds", errors="ignore")
        numbers.append(table.select_dtypes("number"))
        assert bool(planned) == (one is there)
    pd.testing.assert_frame_equal(*numbers, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    "problem",
    [
        replace(PROBLEM, time_step=150.0, collision_radius=30.0),
        replace(PROBLEM, nodes=8).about(ReferenceOrbit(7.6e6, 0.1, 63.0)),
    ],
    ids=["time step", "orbit"],
)
def test_a_refiner_predicts_for_the_data_at_hand_and_not_for_those_of_its_training(
    recorded: Callable[..., object],
    trained: Trained,
    on_solved: DatasetInfo,
    folder: Path,
    problem: Problem,
) -> None:
    """A refiner predicts controls, so predicted and flown rows differ by rounding on any orbit."""
    recorded(replace(trained, model=packaged_weights(trained.model.encoding)), on_solved)
    small = Sample(count=3, shares=(0.0, 0.0, 1.0))
    sample(folder / "other", {CRAFT: small}, problem, workers=ALONE)
    solve(folder / "other", Settings(), workers=ALONE)
    asked = Evaluation(data=str(folder / "other"), models="refiner", timed=0)
    rows = table_of(experiment_run(job.evaluate(asked, workers=ALONE).run_id))
    predicted, flown = (
        rows[(rows.planner == "refiner") & (rows.reading == reading)]
        for reading in ("predicted", "flown")
    )
    assert predicted.fuel.to_numpy() == pytest.approx(flown.fuel.to_numpy(), rel=1e-6)
    assert predicted[["boundary_error", "dynamics_error"]].max(axis=None) < 1e-6
    seeded = WarmStarts(data=str(folder / "other"), models="refiner", sizes=f"{CRAFT}")
    starts = table_of(experiment_run(job.warmstart(seeded).run_id))
    assert set(starts.status) == {"solved"}


def packaged_weights(encoding: Encoding) -> Model:
    """A refiner with the weights of that in the package."""
    architecture = find("refiner")
    network = architecture.network(architecture.config, encoding, 0.0)
    weights = packaged().weights
    assert weights is not None
    network.load_state_dict({name: torch.from_numpy(one) for name, one in weights.items()})
    return Model("refiner", architecture.config, "tuned", encoding, network)


def spied(function: Callable[..., Any], calls: list[Any]) -> Callable[..., Any]:
    """The same function, which leaves its first argument behind."""

    def called(*given: Any) -> Any:
        calls.append(given[0])
        return function(*given)

    return called
