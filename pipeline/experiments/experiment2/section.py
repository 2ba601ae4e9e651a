"""The section on experiment 2: figures and tables against the swarm size."""

from collections.abc import Mapping

import pandas as pd

from pipeline.exhibits.blocks import Picture, Table
from pipeline.exhibits.sections import Section
from pipeline.exhibits.style import Style
from pipeline.experiments import paper
from pipeline.experiments.against import tables_against
from pipeline.experiments.experiment2.figure import QUANTITIES, scaling_figure
from pipeline.experiments.summary import sizes_of_paper

TEMPLATE = "pipeline/experiments/experiment2/section.md.jinja"

PRINTED_SIZES = (2, 5, 10, 20, 30)
"""Swarm sizes that the page shows where they were evaluated; the CSV files have all."""


def section(averages: pd.DataFrame, look: Mapping[str, Style]) -> Section:
    """Figures and tables of the averages from ``summarize``, where there are several sizes.

    Larger swarms than the paper's are left to a section of their own.
    """
    averages = sizes_of_paper(averages)
    sizes = sorted({int(n) for n in averages["n"]})
    if len(sizes) < 2:
        return Section(TEMPLATE, {"sizes": sizes})
    pictures = {
        name: Picture(f"experiment2-{name}", scaling_figure(averages, what, look))
        for name, what in QUANTITIES.items()
        if averages[what.average.source].notna().any()
    }
    tables = scaling_tables(averages)
    return Section(
        TEMPLATE, {"paper": paper, "sizes": sizes, "pictures": pictures, "tables": tables}
    )


def scaling_tables(averages: pd.DataFrame) -> dict[str, Table]:
    """Collisions, share of safe trials and fuel: a column for each of a few swarm sizes."""
    sizes = sorted({int(n) for n in averages["n"]})
    if len(sizes) > len(PRINTED_SIZES) + 1:
        sizes = sorted({*sizes} & {*PRINTED_SIZES} | {sizes[0], sizes[-1]})
    rows = averages.assign(size=averages["n"].astype(str))
    return tables_against(rows, "experiment2", "size", {str(n): f"n = {n}" for n in sizes})
