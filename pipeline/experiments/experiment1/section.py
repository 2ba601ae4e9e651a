"""The section on experiment 1: the paper's Table 2, with its numbers beside ours."""

from collections.abc import Mapping
from dataclasses import asdict, fields

import pandas as pd

from pipeline.exhibits.blocks import Column, Picture, Table
from pipeline.exhibits.numbers import count, number
from pipeline.exhibits.planners import BARGAINING, EXPERTS
from pipeline.exhibits.sections import Section
from pipeline.exhibits.style import Style
from pipeline.experiments import paper, summary
from pipeline.experiments.experiment1.figure import objectives_figure

COLUMNS = [
    *(*summary.NAMED, summary.COLLISIONS, Column("paper", "paper_collisions_mean", number)),
    *(summary.MOST_COLLISIONS, Column("paper", "paper_collisions_max", count)),
    *(summary.CONFLICTS, summary.SAFE, summary.FUEL, Column("paper", "paper_fuel_mean", number)),
    *(summary.FUEL_RATIO, summary.BOUNDARY, summary.DYNAMICS),
]


def section(averages: pd.DataFrame, n: int, look: Mapping[str, Style]) -> Section:
    """Table and figure of the averages from ``summarize`` at one swarm size."""
    table = objectives_table(averages, n)
    trials = table.frame["trials"]
    values = {
        "paper": paper,
        "n": n,
        "refiner": averages["planner"].isin(BARGAINING).any(),
        "trials": sorted({int(trials.min()), int(trials.max())}),
        "table_2": table,
        "figures_2_3": Picture("experiment1", objectives_figure(averages, n, look)),
    }
    return Section("pipeline/experiments/experiment1/section.md.jinja", values)


def objectives_table(averages: pd.DataFrame, n: int) -> Table:
    """The paper's Table 2 at one swarm size; the paper's own figures only belong to n=10."""
    frame = summary.named(averages[averages["n"] == n].reset_index(drop=True))
    quoted = paper.OBJECTIVES if n == paper.NETWORK_SIZE else {}
    rows = [quoted.get("expert" if p in EXPERTS else p) for p in frame["planner"]]
    names = [field.name for field in fields(paper.Objectives)]
    reported = pd.DataFrame([asdict(row) if row else {} for row in rows], columns=names)
    frame = frame.join(reported.add_prefix("paper_"))
    return Table("experiment1", frame, COLUMNS, int(frame["seeds"].max()))
