import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from sentences import Sentences

import pipeline
from cli.jobs.experiments import evaluate, transfer_times
from cli.jobs.report import report
from cli.settings import Evaluation, TransferTimes
from pipeline.errors import InputError
from pipeline.flight.montecarlo import MADE_BY
from pipeline.networks.recipes import architecture_names
from pipeline.parallel.workers import Workers
from pipeline.provenance import FLIGHT, DecidedBy
from pipeline.training.loop import Trained
from registry.environment import EVALUATED_BY, TRAINED_BY, with_architectures
from registry.metrics import add_model_results
from registry.models import ModelVersion, resolve
from registry.results import (
    arrays_of,
    earlier_run,
    evaluation,
    latest,
    record,
    table_of,
    unfinished_parts,
)
from registry.store import EVALUATION, WARMSTART, connect, recorded_run
from registry.training import DatasetInfo

TRIALS = pd.DataFrame(
    {
        "planner": ["expert", "ff1:paper"],
        "n": [10, 10],
        "fuel": [0.0494, 1.91],
        "min_separation": [15.2, np.nan],
        "safe": [True, False],
    }
)


def test_an_evaluation_comes_back_as_it_went_in(folder: Path) -> None:
    run_id = record(EVALUATION, TRIALS, params={"sizes": "2..30", "trials": 100})

    found = latest(EVALUATION)

    assert found.run_id == run_id
    pd.testing.assert_frame_equal(table_of(found), TRIALS)
    assert found.params == {"sizes": "2..30", "trials": "100"}


def test_the_newest_finished_run_counts(folder: Path) -> None:
    record(WARMSTART, TRIALS.head(1), params={})
    newest = record(WARMSTART, TRIALS, params={})
    store = connect()
    with pytest.raises(KeyboardInterrupt), recorded_run(store, "prolearn-warmstart", "x", {}):
        raise KeyboardInterrupt

    found = latest(WARMSTART)

    assert found.run_id == newest
    assert len(table_of(found)) == 2


def test_runs_of_an_experiment_are_told_apart_by_name(
    recorded: Callable[..., ModelVersion], trained: Trained, dataset: DatasetInfo
) -> None:
    of = [recorded(replace(trained, seed=k), dataset).run_id for k in range(2)]
    of += [record(WARMSTART, TRIALS, params={"optimizer": name}) for name in ("expert", "plain")]
    of.append(record(EVALUATION, TRIALS, params={}))
    assert [connect().client.get_run(run_id).info.run_name for run_id in of] == [
        *("ff1-tuned-seed0", "ff1-tuned-seed1", "warmstart-expert", "warmstart-plain"),
        "evaluation",
    ]


def test_without_an_evaluation_the_command_that_makes_one_is_named(folder: Path) -> None:
    with pytest.raises(InputError, match="run `prolearn evaluate` first"):
        evaluation()
    assert latest(WARMSTART) is None


def test_an_evaluation_is_found_by_its_run(folder: Path) -> None:
    first = record(EVALUATION, TRIALS, params={})
    second = record(EVALUATION, TRIALS.head(1), params={})
    other = record(WARMSTART, TRIALS, params={})
    assert len(table_of(evaluation(first))) == 2
    assert evaluation().run_id == second
    with pytest.raises(InputError, match=f"{other!r}; .*newest first: {second}, {first}"):
        evaluation(other)


def test_a_run_that_breaks_off_is_marked_as_failed(folder: Path) -> None:
    store = connect()
    with pytest.raises(ZeroDivisionError), recorded_run(store, EVALUATION, "x", {}) as run_id:
        1 / 0  # noqa: B018
    assert store.client.get_run(run_id).info.status == "FAILED"


def test_arrays_of_a_run_are_fetched(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "made").mkdir()
    np.savez(tmp_path / "made" / "one.npz", x=np.arange(3))
    record(EVALUATION, TRIALS, params={}, files=tmp_path / "made")
    with arrays_of(latest(EVALUATION)) as paths:
        (path,) = paths
        assert path.read_bytes() == (tmp_path / "made" / "one.npz").read_bytes()


def test_more_parameters_and_metrics_than_one_request_takes_all_arrive(
    folder: Path, recorded: Callable[..., ModelVersion], trained: Trained, dataset: DatasetInfo
) -> None:
    params = {f"p{k}": k for k in range(230)}
    metrics = {f"m{k}": float(k) for k in range(1200)}
    record(EVALUATION, TRIALS, params=params)
    assert latest(EVALUATION).params == {k: str(v) for k, v in params.items()}
    add(recorded(trained, dataset), folder, metrics)
    assert resolve("ff1").metrics.items() >= metrics.items()


def add(version: ModelVersion, folder: Path, metrics: dict[str, float], step: int = 0) -> None:
    figures = folder / "figures"
    figures.mkdir(exist_ok=True)
    add_model_results(version, {step: metrics}, figures, dataset=("data", "d1"))


def test_an_evaluation_adds_its_metrics_to_the_models_own_run(
    folder: Path, recorded: Callable[..., ModelVersion], trained: Trained, dataset: DatasetInfo
) -> None:
    version = recorded(trained, dataset)
    add(version, folder, {"n10_flown_node_collisions_mean": 1.5, "n10_flown_fuel_mean": 2.0})
    add(version, folder, {"n10_flown_node_collisions_mean": 0.5})

    metrics = resolve("ff1").metrics
    assert metrics["n10_flown_node_collisions_mean"] == 0.5
    assert metrics["n10_flown_fuel_mean"] == 2.0
    logged = connect().client.get_logged_model(version.model_id).metrics
    assert {m.key for m in logged} >= {"n10_flown_fuel_mean", "best_valid_loss"}


def test_metrics_by_swarm_size_become_a_curve_over_n(
    folder: Path, recorded: Callable[..., ModelVersion], trained: Trained, dataset: DatasetInfo
) -> None:
    version = recorded(trained, dataset)
    for n, fuel in ((2, 0.01), (10, 0.05), (30, 0.15)):
        add(version, folder, {"exp2_flown_fuel_mean": fuel}, step=n)
    curve = connect().client.get_metric_history(version.run_id, "exp2_flown_fuel_mean")
    assert {m.step: m.value for m in curve} == {2: 0.01, 10: 0.05, 30: 0.15}


def test_an_experiment_was_done_earlier_only_with_the_same_parameters(folder: Path) -> None:
    assert earlier_run(EVALUATION, {"trials": 100}) is None
    run_id = record(EVALUATION, TRIALS, params={"trials": 100, "sizes": "10"})

    assert earlier_run(EVALUATION, {"sizes": "10", "trials": 100}) == run_id
    assert earlier_run(EVALUATION, {"sizes": "10", "trials": 99}) is None
    assert earlier_run(EVALUATION, {"sizes": "10"}) is None
    record(EVALUATION, TRIALS, params={"trials": 5, "sizes": "10"})
    # the report shows the newest results, so older ones do not count as done
    assert earlier_run(EVALUATION, {"sizes": "10", "trials": 100}) is None


def test_an_experiment_hangs_on_what_runs_it_and_on_no_figure_text_or_verdict() -> None:
    root = Path(pipeline.__file__).parents[1]
    found = {pattern: sorted(root.glob(pattern)) for pattern in EVALUATED_BY[0]}
    assert all(found.values())
    files = {path.relative_to(root).as_posix() for paths in found.values() for path in paths}
    decided = files - {*FLIGHT}
    assert decided == {
        "pipeline/experiments/example_transfer.py",
        "pipeline/experiments/flights.py",
        "pipeline/experiments/records.py",
        "pipeline/experiments/trials.py",
        "pipeline/experiments/warmstart.py",
        "cli/jobs/experiments.py",
    }


COMPUTE = {"numpy", "scipy", "clarabel", "highspy", "cvxpy", "torch"}
"""Of what our code imports, the distributions that compute."""


@pytest.mark.parametrize("decided_by", [EVALUATED_BY, TRAINED_BY, MADE_BY])
def test_what_computes_in_the_code_that_decides_a_result_is_known_by_its_version(
    decided_by: DecidedBy,
) -> None:
    root = Path(pipeline.__file__).parents[1]
    paths = [path for pattern in decided_by[0] for path in root.glob(pattern)]
    files = [file for path in paths for file in (path.rglob("*.py") if path.is_dir() else [path])]
    text = "\n".join(file.read_text() for file in files)
    imported = {*re.findall(r"^\s*(?:import|from) (\w+)", text, re.MULTILINE)}
    assert imported & COMPUTE <= {*decided_by[1]}


def test_what_our_own_architectures_make_depends_on_no_other_code() -> None:
    assert with_architectures(TRAINED_BY, architecture_names()) == TRAINED_BY


def test_parts_are_for_the_code_that_made_them(folder: Path) -> None:
    parts, packages = EVALUATED_BY
    for made_by in (EVALUATED_BY, (parts, (*packages, "threadpoolctl:threadpoolctl"))):
        with (
            pytest.raises(KeyboardInterrupt),
            unfinished_parts(EVALUATION, {"trials": 1}, made_by, resume=True),
        ):
            raise KeyboardInterrupt
    assert len([*Path("mlruns/.unfinished").iterdir()]) == 2


def test_an_evaluation_of_the_same_models_and_data_is_the_same_however_they_are_named(
    register: Callable[..., Any], solved: Path
) -> None:
    for noise in (1.0, 2.0):
        register(noise)
    asked = Evaluation(models="ff1/1,ff1/2", data=str(solved), sizes="3", trials=2, timed=0)
    alone = Workers(jobs=1)
    first = evaluate(asked, workers=alone, resume=True)
    renamed = replace(asked, models="ff1/2,ff1/1", data=f"{solved}/")
    again = evaluate(renamed, workers=alone, resume=True)
    assert (again.run_id, again.earlier) == (first.run_id, True)


def test_results_of_a_deleted_model_are_not_those_of_a_new_one_with_its_uri(
    register: Callable[..., Any], solved: Path
) -> None:
    register(1.0)
    asked, alone = Evaluation(data=str(solved), sizes="3", trials=1, timed=0), Workers(jobs=1)
    first = evaluate(asked, workers=alone)
    of_first = TransferTimes(data=str(solved), n=3, nodes="6,11", trials=1)
    times = transfer_times(of_first, workers=alone)
    assert evaluate(asked, workers=alone, resume=True).earlier
    connect().client.delete_registered_model("prolearn-ff1")
    assert register(2.0)[0].uri == evaluation(first.run_id).params["models"]

    assert not evaluate(asked, workers=alone, resume=True).earlier
    text = report(Path("new")).markdown.read_text()
    assert f"Experiment 4: the newest run ({times.run_id}, 20" in text
    assert "no longer there" not in text
    text = report(Path("old"), first.run_id).markdown.read_text()
    assert "evaluated models that are no longer there: 1." in text
    assert "Experiment 4: the newest run" not in text


def test_an_experiment_of_other_versions_is_not_taken_for_done_and_says_which(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    progress = Sentences()
    run_id = record(EVALUATION, TRIALS, params={"trials": 100})
    tags = evaluation().tags
    versions = json.loads(tags["made_with"]) | {"clarabel": "0.1.2"}
    connect().client.set_tag(run_id, "made_with", json.dumps(versions))
    assert earlier_run(EVALUATION, {"trials": 100}, progress=progress) is None
    (sentence,) = progress.said
    assert f"run {run_id} of prolearn-evaluation was made with clarabel 0.1.2, now" in sentence
