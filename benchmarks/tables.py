"""Results of benchmarks as tables on the screen and as JSON files."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from cli.output import echo
from pipeline.arrays import Array
from pipeline.files import write_text
from pipeline.plan import SOLVED, Plan

Row = dict[str, float | int | str]  # a line of a table, by column


def show(title: str, rows: Sequence[Mapping[Any, Any]]) -> None:
    """Print a table whose columns are the keys of its rows."""
    table = pd.DataFrame(rows).rename(columns=lambda name: name.replace("_", " "))
    lines = table.to_string(index=False, float_format="{:.3g}".format).splitlines()
    echo(title, *lines, "")


def quartiles(values: Array) -> str:
    """Lower and upper quartile, in words."""
    low, high = np.percentile(values, [25, 75])
    return f"{low:.3g} to {high:.3g}"


def write_json(path: Path, result: Any) -> None:
    write_text(path, json.dumps(result, indent=1) + "\n")


def quality(plans: Sequence[Plan]) -> Row:
    """Columns of a table: unsafe plans, collisions, and fuel over the bound."""
    certificates = [plan.certificate for plan in plans]
    ratio = [c.fuel / c.fuel_lower_bound for c in certificates]
    return {
        "unsafe_%": 100 * float(np.mean([plan.status != SOLVED for plan in plans])),
        "node_collisions": float(np.mean([c.node_collisions for c in certificates])),
        "fuel/bound": f"{np.mean(ratio):.5f}",
    }
