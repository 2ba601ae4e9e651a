"""Table of experiment 1, with the paper's numbers beside ours."""

import math

import pandas as pd

from pipeline.exhibits.blocks import Column, Table
from pipeline.exhibits.numbers import count, error, number, ratio, share
from pipeline.exhibits.planners import EXPERTS, name_of
from pipeline.experiments import paper
from pipeline.experiments.spread import INTERVALS, SAFE, spread_note


def objectives_table(summary: pd.DataFrame, n: int) -> Table:
    """The paper's Table 2 at one swarm size; the paper's own figures only belong to n=10."""
    frame = summary[summary["n"] == n].reset_index(drop=True)
    quoted = paper.OBJECTIVES if n == paper.NETWORK_SIZE else {}
    rows = [quoted.get("expert" if p in EXPERTS else p) for p in frame["planner"]]
    frame = frame.assign(
        name=[name_of(p) for p in frame["planner"]],
        paper_collisions_mean=[r.collisions_mean if r else math.nan for r in rows],
        paper_collisions_max=[r.collisions_max if r else math.nan for r in rows],
        paper_fuel_mean=[r.fuel_mean if r else math.nan for r in rows],
    )
    columns = [
        Column("Planner", "name"),
        Column("Recipe", "recipe"),
        Column("Reading", "reading"),
        Column("Collisions, av.", "collisions_mean", number, "collisions_spread"),
        Column("paper", "paper_collisions_mean", number),
        Column("Collisions, max.", "collisions_max", count),
        Column("paper ", "paper_collisions_max", count),
        Column("Pairs too close, av.", "conflicts_mean", number),
        Column("Safe at all times", "safe_share", share, "safe_spread", SAFE),
        Column("Fuel, av. (m/s²)", "fuel_mean", number, "fuel_spread"),
        Column("paper  ", "paper_fuel_mean", number),
        Column("Fuel / bound, av.", "fuel_ratio", ratio, "fuel_ratio_spread"),
        Column("Boundary error (m)", "boundary_error", error),
        Column("Dynamics error (m)", "dynamics_error", error),
    ]
    caption = (
        f"Collisions, safety and fuel at n = {n} over {_trials(frame)} trials (the paper's "
        "Table 2). Collisions count pairs and nodes (Eq. 5); pairs too close count pairs that "
        "come within the collision radius at any time; fuel is Eq. 4; the bound is the fuel that "
        "the craft need when they ignore each other; errors are averages of each trial's largest."
        f"{INTERVALS}{spread_note(frame)}"
    )
    return Table("experiment1", caption, frame, columns)


def _trials(frame: pd.DataFrame) -> str:
    low, high = int(frame["trials"].min()), int(frame["trials"].max())
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"
