"""Cost of making, verifying, reading and training on a large dataset, extrapolated to 10⁸ rows.

    python -m benchmarks.scale --rows 1000000 --folder data/scale

Each stage is a command in a process of its own, whose time and memory the operating system
measures. In a folder of an earlier run it goes on where that stopped. Prints a table, and writes
scale.json.
"""

import os
import subprocess
import sys
from pathlib import Path
from time import monotonic
from typing import Annotated

import numpy as np
import typer

from benchmarks.tables import BENCH, OutOption, TableRow, show, write_json
from pipeline.dataset.examples import ExampleStream
from pipeline.dataset.reading import solved_examples
from pipeline.storage.folder import open_folder

N = 10
MANY = 10**8  # rows to which the figures are extrapolated
PROGRAM = "from cli.main import app; app()"
READING = "from benchmarks.scale import read_shuffled; read_shuffled({!r}, {!r}, {!r})"


def main(
    folder: Annotated[Path, typer.Option(help="Of the dataset and the store.")] = Path(
        "data/scale"
    ),
    rows: Annotated[int, typer.Option(help="Scenarios of n=10.")] = 1_000_000,
    rows_per_shard: Annotated[int, typer.Option(help="Scenarios in a file.")] = 12_500,
    jobs: Annotated[int, typer.Option(help="Processes, -1 for one a core.")] = -1,
    memory: Annotated[float, typer.Option(help="GB that reading and training may take.")] = 1.0,
    out: OutOption = BENCH,
) -> None:
    """Run all stages and print a table."""
    data = str(folder / "data")
    many = ["--n", str(N), "--count", str(rows), "--rows-per-shard", str(rows_per_shard)]
    working = ["--jobs", str(jobs)]
    training = ["--data", data, "--n", str(N), "--epochs", "1", "--memory", str(memory)]
    stages = {
        "sample": [PROGRAM, "sample", *many, "--out", data, *working],
        "solve": [PROGRAM, "solve", data, *working],
        "verify": [PROGRAM, "verify", data, *working],
        "list": [
            "from pipeline.dataset.manifest import read_manifest; "
            f"[*read_manifest({data!r}).expected()]"
        ],
        "read": [READING.format(data, 0, memory * 1e9)],
        "train": [PROGRAM, "train", "--arch", "ff1", "--seed", "0", *training],
    }
    table = [_row(stage, command, folder, rows) for stage, command in stages.items()]
    show(f"{rows} rows of n={N} in {size_of(data) / 1e9:.3g} GB", table)
    write_json(out / "scale.json", table)


def size_of(data: str) -> int:
    """Bytes of the solved shards of a dataset."""
    folder = open_folder(data)
    return sum(folder.size(name) for name in folder.names() if name.startswith("n="))


def read_shuffled(data: str, seed: int, memory: float) -> None:
    """Read every example of the training split once, its shards in random order."""
    source = solved_examples(data, N, "train", memory)
    parts = np.random.default_rng(seed).permutation(source.part_count).tolist()
    assert sum(len(part) for part in source.parts(parts)) == len(source)
    kind = "streamed" if isinstance(source, ExampleStream) else "loaded"
    print(len(source), "examples", kind)


def _row(stage: str, command: list[str], folder: Path, rows: int) -> TableRow:
    started = monotonic()
    environment = os.environ | {"MLFLOW_TRACKING_URI": f"sqlite:///{folder}/mlflow.db"}
    process = subprocess.Popen([sys.executable, "-c", *command], env=environment)
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{stage} ended with status {os.waitstatus_to_exitcode(status)}")
    seconds, busy = monotonic() - started, used.ru_utime + used.ru_stime
    return {
        "stage": stage,
        "wall_s": seconds,
        "cpu_s": busy,
        "cpu_ms_a_row": 1e3 * busy / rows,
        "largest_process_MB": used.ru_maxrss / 1e3,
        "MB_a_CPU_s": size_of(str(folder / "data")) / 1e6 / busy,
        "core_hours_at_1e8": busy / rows * MANY / 3600,
    }


if __name__ == "__main__":
    typer.run(main)
