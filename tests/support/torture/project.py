"""The project that is tortured: a dataset, a store with models and results, plans and flights."""

import hashlib
import os
import shutil
from pathlib import Path

from forked import Forked
from short_transfer import OPTIONS, PROBLEM

from pipeline.dataset.making import sample, solve
from pipeline.dataset.samples import Sample
from pipeline.expert import Settings
from pipeline.parallel.workers import Workers

SAMPLES = {
    2: Sample(count=12, shares=(0.5, 0.25, 0.25), shard_rows=3),
    3: Sample(count=24, shares=(0.5, 0.25, 0.25), shard_rows=6),
}
DATA = ("--data", "data")
FLY = ("fly", "plan.json", "--trials", "120", "--world", "linear", "--out", "flown", "--jobs", "1")
TRAIN = ("train", "--arch", "ff1", *DATA, "--n", "3", "--epochs", "1", "--resume")
EVALUATE = (
    "evaluate",
    *DATA,
    "--models",
    "ff1",
    "--n",
    "3",
    "--timed",
    "0",
    "--jobs",
    "1",
    "--resume",
)
WARMSTART = ("warmstart", *DATA, "--models", "ff1", "--n", "3", "--trials", "2", "--resume")

MADE_BY = (
    ("scenario", "new", "scenario.json", "--n", "4", *OPTIONS),
    ("plan", "scenario.json", "--out", "plan.json"),
    FLY,
    TRAIN,
    (*TRAIN, "--recipe", "paper"),
    ("train", "--arch", "refiner", *DATA, "--n", "3", "--epochs", "1", "--crowded", "4"),
    EVALUATE,
    WARMSTART,
)
"""Commands that make the project, but for its datasets."""

READERS = (
    (*EVALUATE, "--json"),
    (*WARMSTART, "--json"),
    *(
        ("plan", "scenario.json", "--planner", name, "--raw", "--out", "p.json", "--json")
        for name in ("prolearn-ff1/1", "prolearn-ff1/2", "prolearn-refiner/1")
    ),
)
"""Commands that read results and networks."""


ENVIRONMENT = {"COLUMNS": "80", "MLFLOW_DISABLE_TELEMETRY": "true", "LOKY_MAX_CPU_COUNT": "1"}
"""Worker processes are started where they are asked for."""

VARYING = ("seconds", "time_ratio", "run_id", '"earlier"')
"""Words in lines that differ where something is done again."""

LETTER = "letter.tmp"
"""A file of somebody else's, in every folder that commands write to."""


def environment() -> dict[str, str]:
    """What commands run in."""
    kept = {name: value for name, value in os.environ.items() if "MLFLOW" not in name}
    return kept | ENVIRONMENT


def make(folder: Path, commands: Forked, store: Path | None) -> None:
    """Make the project in a folder, with a copy of an empty MLflow store if one is given."""
    one = Workers(jobs=1)
    sample(folder / "data", SAMPLES, PROBLEM, workers=Workers(1))
    shutil.copytree(folder / "data", folder / "sampled")
    solve(folder / "data", Settings(), workers=one)
    if store:
        shutil.copy(store, folder / "mlflow.db")
    for arguments in MADE_BY:
        done = commands.run([*arguments], folder, environment())
        assert done.returncode == 0, done.stderr
    shutil.copytree(folder / "data", folder / "hurt")
    for name in ("n=2/part-00001.parquet", "_scenarios/n=3/part-00002.parquet"):
        path = folder / "hurt" / name
        path.write_bytes(path.read_bytes()[:-50])
    for place in (".", "data", "data/n=2", "flown", "mlruns"):
        (folder / place / f".{LETTER}").write_text("not prolearn's")


def rows_of(folder: Path) -> dict[str, str]:
    """Digest of each file of a folder of shards that is the same however it was made."""
    varying = {"_lock", "_writer", "_stamps.json", "_timings", "_damaged", "_foreign"}
    paths = [path.relative_to(folder) for path in folder.rglob("*") if path.is_file()]
    return {
        path.as_posix(): hashlib.sha256((folder / path).read_bytes()).hexdigest()
        for path in sorted(paths)
        if not varying & {*path.parts} and path.suffix in (".parquet", ".json", ".md")
    }


def untimed(out: str) -> str:
    """What a command says without times, and without the run that it is from."""
    kept = [line for line in out.splitlines() if not any(word in line for word in VARYING)]
    return "\n".join(kept)


def letters(folder: Path) -> int:
    """How many of the files of somebody else's are there."""
    return len(list(folder.rglob(f".{LETTER}*")))
