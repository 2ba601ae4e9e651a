"""Tables of experiment 2: a row for each planner, a column for each of a few swarm sizes."""

import pandas as pd

from pipeline.exhibits.blocks import Table
from pipeline.experiments.against import Against, tables_against

PRINTED_SIZES = (2, 5, 10, 20, 30)
"""Swarm sizes that the page shows where they were evaluated; the CSV files have all."""


def scaling_tables(summary: pd.DataFrame) -> list[Table]:
    """Collisions, share of safe trials and fuel against n."""
    sizes = sorted(int(n) for n in summary["n"].unique())
    printed = {str(n): f"n = {n}" for n in _printed(sizes)}
    against = Against("experiment2", "swarm size", "size", printed)
    return tables_against(summary.assign(size=summary["n"].astype(int).astype(str)), against)


def _printed(sizes: list[int]) -> list[int]:
    """The usual sizes with the smallest and largest; all of them where they are few."""
    if len(sizes) <= len(PRINTED_SIZES) + 1:
        return sizes
    return [n for n in sizes if n in PRINTED_SIZES or n in (sizes[0], sizes[-1])]
