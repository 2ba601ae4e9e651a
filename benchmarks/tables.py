"""Helpers of benchmarks: tables on the screen, in JSON files and on pages; limits of CPU time."""

import json
import os
import resource
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from math import ceil
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer
from threadpoolctl import threadpool_limits

from cli.output import echo
from pipeline.arrays import Array
from pipeline.files import write_text
from pipeline.plan.plan import SOLVED, Plan

BENCH = Path("reports/bench")
OutOption = Annotated[Path, typer.Option(help="Folder for the tables, as JSON.")]
TableRow = dict[str, float | int | str]  # a line of a table, by column
PageOption = Annotated[
    Path | None,
    typer.Option(exists=True, dir_okay=False, help="Page whose tables are made anew."),
]


def show(title: str, rows: Sequence[Mapping[Any, Any]]) -> None:
    """Print a table whose columns are the keys of its rows."""
    table = pd.DataFrame(rows).rename(columns=lambda name: name.replace("_", " "))
    lines = table.to_string(index=False, float_format="{:.3g}".format).splitlines()
    echo(title, *lines, "")


def quartiles(values: Array) -> str:
    """Lower and upper quartile, as text."""
    low, high = np.percentile(values, [25, 75])
    return f"{low:.3g} to {high:.3g}"


def write_json(path: Path, result: Any) -> None:
    write_text(path, json.dumps(result, indent=1) + "\n")


def quality(plans: Sequence[Plan]) -> TableRow:
    """Columns of a table: unsafe plans, collisions, and fuel over the bound."""
    certificates = [plan.certificate for plan in plans]
    ratio = [c.fuel / c.fuel_lower_bound for c in certificates]
    return {
        "unsafe_%": 100 * float(np.mean([plan.status != SOLVED for plan in plans])),
        "node_collisions": float(np.mean([c.node_collisions for c in certificates])),
        "fuel/bound": f"{np.mean(ratio):.5f}",
    }


def update_page(page: Path | None, mark: str, text: str) -> None:
    """Print a text and, if a page is given, put it between the page's two marks."""
    echo(*text.splitlines())
    if page is not None:
        before, _, after = page.read_text(encoding="utf-8").split(mark)
        write_text(page, f"{before}{mark}\n\n{text}\n\n{mark}{after}")


def use_one_core() -> None:
    """Keep this process and its children on one core, where the system can."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def limited_process(patience: float) -> ProcessPoolExecutor:
    """A process with one thread, which the system ends after ``patience`` s of CPU time.

    Its ``process_time`` may then count in ticks of some ms; ``thread_time`` does not.
    """
    return ProcessPoolExecutor(1, get_context("spawn"), _limit, (patience,))


def _limit(patience: float) -> None:
    most = ceil(patience)
    resource.setrlimit(resource.RLIMIT_CPU, (most, most))
    threadpool_limits(1)
