"""Commands that are killed, or whose disk is full, at a random moment, and then run again."""

import csv
import hashlib
import json
import os
import resource
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any

from processes import workers_of

from torture.bench import Bench
from torture.project import DATA, EVALUATE, FLY, TRAIN, WARMSTART, letters, rows_of
from torture.store import facts
from torture.tally import Outcome, Tally

KILLED, TERMINATED, FULL = "kill -9", "SIGTERM", "full disk"

FIRST = "train without a store"
"""The command that makes one."""

ROOM = 2048
"""Bytes that a file may still have once the disk is full: enough for what a command says."""

TIMES = ("timing", "seconds", "CREATION_DATE")
"""Words in what differs from run to run."""

Facts = Callable[[Path], Any]


def plans(folder: Path) -> Any:
    """Plan files without times."""
    found = {}
    for path in sorted(folder.rglob("*.plan.json")):
        found[path.name] = {k: v for k, v in json.loads(path.read_text()).items() if k != "timing"}
    return found


def lines_of(*names: str) -> Facts:
    """Digests of files, without lines that have a time in them."""

    def read(folder: Path) -> Any:
        found = {}
        for path in sorted(path for name in names for path in folder.glob(name)):
            kept = [
                line
                for line in path.read_bytes().split(b"\n")
                if not any(word.encode() in line for word in TIMES)
            ]
            found[path.name] = hashlib.sha256(b"\n".join(kept)).hexdigest()
        return found

    return read


def columns(folder: Path) -> Any:
    """A trade-off's table without times, and its plans."""
    with (folder / "trade/tradeoff.csv").open() as file:
        rows = [{k: v for k, v in row.items() if k not in TIMES} for row in csv.DictReader(file)]
    return rows, plans(folder / "trade")


def without_tuning(folder: Path) -> Any:
    """A store without the trials of searches: which those are depends on when one is cut short."""
    found = facts(folder)
    others = [run for run in found["finished"] if run[0] != "prolearn-tuning"]
    return {**found, "finished": others}


def names_of(*patterns: str) -> Facts:
    """Names of files whose content has times in it."""
    return lambda folder: sorted(p.name for one in patterns for p in folder.glob(one))


COMMANDS: dict[str, tuple[tuple[str, ...], Facts]] = {
    "sample": (
        ("sample", "--n", "4", "--count", "60", "--out", "new", "--jobs", "2"),
        lambda folder: rows_of(folder / "new"),
    ),
    "solve": (("solve", "sampled", "--jobs", "2"), lambda folder: rows_of(folder / "sampled")),
    "verify --repair": (
        ("verify", "hurt", "--repair", "--jobs", "2"),
        lambda folder: rows_of(folder / "hurt"),
    ),
    "dataset card": (("dataset", "card", "data"), lambda folder: rows_of(folder / "data")),
    "fly --trials": (
        (*FLY[:-4], "--out", "again", "--replan", "every-node", "--effort", "first", "--jobs", "2"),
        lambda folder: rows_of(folder / "again"),
    ),
    "plan": (("plan", "scenario.json", "--out", "new.plan.json"), plans),
    "show": (("show", "plan.json"), lines_of("plan.html")),
    "convert": (("convert", "plan.json", "--to", "csv"), lines_of("plan.csv")),
    "scenario new": (("scenario", "new", "new.json", "--force"), lines_of("new.json")),
    "tradeoff": (
        ("tradeoff", "scenario.json", "--duration", "15..25min", "--steps", "4", "--out", "trade"),
        columns,
    ),
    "train": ((*TRAIN, "--seed", "7"), facts),
    FIRST: (TRAIN, facts),
    "evaluate": ((*EVALUATE, "--trials", "3"), facts),
    "warmstart": ((*WARMSTART, "--n", "2"), facts),
    "transfer-times": (
        ("transfer-times", *DATA, "--models", "ff1", "--n", "3", "--nodes", "6", "--resume"),
        facts,
    ),
    "flights": (
        (
            *("flights", *DATA, "--models", "refiner", "--n", "3", "--trials", "1"),
            *("--flights", "1", "--jobs", "1", "--resume"),
        ),
        facts,
    ),
    "tune": (
        (
            *("tune", "--arch", "ff1", *DATA, "--n", "3", "--epochs", "1"),
            *("--trials", "2", "--at-once", "2", "--jobs", "2"),
        ),
        without_tuning,
    ),
    "models export": (
        ("models", "export", "ff1", "--out", "exported.onnx"),
        names_of("exported*"),
    ),
    "models promote": (
        ("models", "promote", "ff1", "--version", "2", "--force"),
        facts,
    ),
    "report": (("report", "--out", "new"), lines_of("new/report.md", "new/tables/*.csv")),
}
"""Every command that writes, and what it leaves that is the same in every run."""


class Interruption:
    """Tries on copies of the project, and what came of them."""

    def __init__(self, bench: Bench, seed: int, tally: Tally) -> None:
        self._bench, self._chance, self._tally = bench, Random(seed), tally
        self._usual: dict[str, tuple[Any, float]] = {}

    def many(self, kind: str, tries: int) -> None:
        """Interrupt every command in turn, so many times in all."""
        names = list(COMMANDS)
        self._chance.shuffle(names)
        for k in range(tries):
            name = names[k % len(names)]
            outcome, story = self._one(kind, name)
            self._tally.add(kind, f"{len(COMMANDS)} commands", outcome, f"{name} {story}")

    def _fresh(self, name: str) -> Path:
        """A fresh copy of the project, as a command finds it."""
        folder = self._bench.fresh()
        if name == FIRST:
            (folder / "mlflow.db").unlink()
        return folder

    def _undisturbed(self, name: str) -> tuple[Any, float]:
        """What a command leaves that nobody interrupts, and how long it takes."""
        if name not in self._usual:
            arguments, left = COMMANDS[name]
            folder, started = self._fresh(name), time.monotonic()
            status, _, err = self._bench.run(*arguments)
            assert status == 0, err
            self._usual[name] = left(folder), time.monotonic() - started
        return self._usual[name]

    def _one(self, kind: str, name: str) -> tuple[Outcome, str]:
        arguments, left = COMMANDS[name]
        wanted, seconds = self._undisturbed(name)
        folder, moment = self._fresh(name), self._chance.uniform(0, seconds)
        workers: list[int] = []

        def meanwhile(process: int) -> None:
            time.sleep(moment)
            with suppress(ProcessLookupError):
                workers.extend(workers_of(process))
                interrupt(process, kind)

        status, _, err = self._bench.run(*arguments, meanwhile=meanwhile)
        story = f"after {moment:.2f} of {seconds:.2f} s"
        if "Traceback" in err:
            return Outcome.TRACEBACK, f"{story}: {err}"
        if not _end(workers):
            return Outcome.ORPHANS, story
        ended = status == 0
        status, _, err = self._bench.run(*arguments)
        if "Traceback" in err:
            return Outcome.TRACEBACK, f"{story}, again: {err}"
        if status != 0:
            return Outcome.LOST, f"{story}: {err}"
        if left(folder) != wanted or letters(folder) != letters(self._bench.project):
            return Outcome.LOST, f"{story}: other results"
        return (Outcome.NOTHING if ended else Outcome.MENDED), ""


def interrupt(process: int, kind: str) -> None:
    """Kill a process, or let it write no more."""
    if kind == FULL:
        _, hard = resource.prlimit(process, resource.RLIMIT_FSIZE)
        resource.prlimit(process, resource.RLIMIT_FSIZE, (ROOM, hard))
    else:
        os.kill(process, signal.SIGKILL if kind == KILLED else signal.SIGTERM)


def _end(processes: list[int], seconds: float = 10.0) -> bool:
    """Whether processes end within some seconds."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if not any(Path(f"/proc/{process}/fd").exists() for process in processes):
            return True
        time.sleep(0.1)
    return False
