"""Experiments killed (-9) half way: the parts that were done are used by the next run."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from cli.jobs import experiments
from cli.settings import Evaluation, ExperimentSettings, Flights, TransferTimes, WarmStarts
from pipeline.errors import InputError
from pipeline.parallel.workers import Workers
from pipeline.progress import Progress
from pipeline.training.loop import Trained
from registry.results import experiment_run, table_of
from registry.training import DatasetInfo

pytestmark = pytest.mark.system

DONE = 2  # parts after which most runs are killed
TWO = {"models": "lstm1", "trials": 2}

KILLED = """
import os, signal
from cli.jobs.experiments import {job} as job
from cli.settings import *
from pipeline.parallel.workers import Workers
from pipeline.progress import Progress

class Deadly(Progress):
    count = 0

    def done(self, units=1, note="", *, failed=None):
        self.count += units
        if self.count == {done}:
            os.kill(os.getpid(), signal.SIGKILL)

job({asked}, {told})
"""


class Counts(Progress):
    """Counts parts that are kept and such that are made."""

    def __init__(self) -> None:
        self.total, self.kept, self.made = 0, 0, 0

    def expect(self, total: int) -> None:
        self.total = total

    def done(self, units: int = 1, note: str = "", *, failed: int | None = None) -> None:
        if note == "kept":
            self.kept += units
        else:
            self.made += units


@pytest.fixture
def registered(
    recorded: Callable[..., object], trained_lstm: Trained, on_solved: DatasetInfo
) -> None:
    recorded(trained_lstm, on_solved)


def kill(
    child: Callable[[str], int],
    job: str,
    asked: ExperimentSettings,
    jobs: int | None = None,
    done: int = DONE,
) -> list[Path]:
    """The parts of a run that is killed after some."""
    told = "progress=Deadly()"
    if jobs is not None:
        told = f"workers=Workers({jobs}, {told})"
    assert child(KILLED.format(job=job, asked=asked, told=told, done=done)) == -9
    return sorted(Path("mlruns/.unfinished").rglob("*.parquet"))


def untimed(run_id: str) -> pd.DataFrame:
    return table_of(experiment_run(run_id)).drop(columns="seconds", errors="ignore")


@pytest.mark.parametrize(
    ("job", "settings", "jobs"),
    [
        ("evaluate", lambda data: Evaluation(data=data, timed=1, **TWO), 2),
        (
            "transfer_times",
            lambda data: TransferTimes(data=data, n=3, nodes="6", time_steps="60", **TWO),
            1,
        ),
        ("warmstart", lambda data: WarmStarts(data=data, sizes="3", **(TWO | {"trials": 3})), None),
        # Without a network, whose flights are long.
        ("flights", lambda data: Flights(data=data, n=3, flights=1, trials=2), 1),
    ],
)
def test_what_was_done_before_a_kill_is_not_done_again(
    registered: None, solved: Path, child: Callable[[str], int], job: str, settings: Any, jobs: Any
) -> None:
    asked, run = settings(str(solved)), getattr(experiments, job)
    options = {} if jobs is None else {"workers": Workers(jobs=1)}
    before = 1 if job == "flights" else DONE  # whose parts take longest
    parts = kill(child, job, asked, jobs, before)
    timed = [path for path in parts if path.parent.name == "table=times"]
    assert len(parts) - len(timed) == before
    assert len(timed) == (job == "evaluate")

    told = Counts()
    telling = {"progress": told} if jobs is None else {"workers": Workers(1, progress=told)}
    done = run(asked, resume=True, **telling)
    assert (told.kept, told.made) == (before, told.total - before)
    assert told.made > 0
    assert not list(Path("mlruns/.unfinished").rglob("*")), "the run has it all"
    afresh = run(asked, **options)
    assert not afresh.earlier
    pd.testing.assert_frame_equal(untimed(done.run_id), untimed(afresh.run_id))


def test_parts_that_are_damaged_or_of_other_settings_or_not_asked_for_are_done_again(
    solved: Path, child: Callable[[str], int]
) -> None:
    asked = Evaluation(data=str(solved), timed=0, trials=2)
    first, _ = kill(child, "evaluate", asked, 1)
    content = bytearray(first.read_bytes())
    content[len(content) // 2] ^= 1
    first.write_bytes(content)

    def counted(settings: Evaluation, *, resume: bool) -> Counts:
        told = Counts()
        experiments.evaluate(settings, workers=Workers(1, progress=told), resume=resume)
        return told

    fewer = replace(asked, trials=1)
    assert counted(fewer, resume=True).kept == 0
    assert counted(asked, resume=True).kept == 1
    kill(child, "evaluate", asked, 1)
    assert counted(asked, resume=False).kept == 0


def test_the_same_experiment_twice_at_once_is_refused_and_leaves_the_first_alone(
    folder: Path, solved: Path
) -> None:
    asked = Evaluation(data=str(solved), timed=0, trials=2)

    class Again(Counts):
        def done(self, units: int = 1, note: str = "", *, failed: int | None = None) -> None:
            super().done(units, note)
            if self.made == DONE:
                with pytest.raises(InputError, match="is being written by process"):
                    experiments.evaluate(asked, workers=Workers(jobs=1), resume=True)

    told = Again()
    experiments.evaluate(asked, workers=Workers(1, progress=told))
    assert told.made == told.total
