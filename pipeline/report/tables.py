"""Tables of experiment 1 and of training, with the paper's numbers beside ours."""

import math

import pandas as pd

from pipeline.report import paper_values
from pipeline.report.blocks import Column, Table
from pipeline.report.numbers import count, error, number, ratio, share
from pipeline.report.style import EXPERTS, in_order, name_of


def objectives_table(summary: pd.DataFrame, n: int) -> Table:
    """The paper's Table 2 at one swarm size; the paper's own figures only belong to n=10."""
    frame = summary[summary["n"] == n].reset_index(drop=True)
    quoted = paper_values.OBJECTIVES if n == paper_values.NETWORK_SIZE else {}
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
        Column("Safe at all times", "safe_share", share, "safe_spread"),
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
        f"{spread_note(frame)}"
    )
    return Table("experiment1", caption, frame, columns)


def training_table(training: pd.DataFrame) -> Table:
    """The paper's Tables 1 and 3 for the models that were trained, averaged over their seeds."""
    order = in_order(training["arch"])
    frame = _over_seeds(training).sort_values(
        ["arch", "recipe"],
        key=lambda c: c.map(order.index) if c.name == "arch" else c,
        ignore_index=True,
        kind="stable",
    )
    frame = frame.assign(
        name=[name_of(a) for a in frame["arch"]],
        paper_neurons=[_layers(a) for a in frame["arch"]],
        paper_seconds=[paper_values.TRAIN_SECONDS.get(a, math.nan) for a in frame["arch"]],
    )
    columns = [
        Column("Model", "name"),
        Column("Recipe", "recipe"),
        Column("Versions", "versions"),
        Column("Neurons (paper)", "paper_neurons"),
        Column("Weights", "parameters", count),
        Column("Size (KiB)", "weights_kib", number),
        Column("Instances", "train_instances", count),
        Column("Epochs", "epochs", count),
        Column("Best epoch", "best_epoch", count),
        Column("Validation loss", "valid_loss", number, "valid_loss_spread"),
        Column("Time (s)", "seconds", number, "seconds_spread"),
        Column("paper (s)", "paper_seconds", number),
        Column("Device", "device"),
    ]
    caption = (
        "Training of each model beside the paper's layers and training times (its Tables 1 and "
        "3). Losses of different recipes have different targets and do not compare."
        f"{spread_note(frame)}"
    )
    return Table("training", caption, frame, columns)


def facts_table(facts: pd.DataFrame) -> Table:
    """What the results were made from and with."""
    columns = [Column("Fact", "fact"), Column("Value", "value")]
    return Table("provenance", "Where these results come from.", facts, columns)


def spread_note(frame: pd.DataFrame) -> str:
    """What ± means, where a table has averages over several trainings (column ``seeds``)."""
    most = int(frame["seeds"].max())
    if most < 2:
        return ""
    return (
        f" Networks trained with several seeds (up to {most}) show the average of their trainings "
        "± the standard deviation between them."
    )


def _over_seeds(training: pd.DataFrame) -> pd.DataFrame:
    """One row for the trainings that differ in their seed alone."""
    groups = training.assign(recipe=training["recipe"].fillna("")).groupby(
        ["arch", "recipe"], as_index=False, sort=False
    )
    return groups.agg(
        versions=("version", lambda v: ", ".join(str(k) for k in v)),
        seeds=("training_seed", "nunique"),
        parameters=("parameters", "first"),
        weights_kib=("weights_kib", "mean"),
        train_instances=("train_instances", "mean"),
        epochs=("epochs", "mean"),
        best_epoch=("best_epoch", "mean"),
        valid_loss=("valid_loss", "mean"),
        valid_loss_spread=("valid_loss", "std"),
        seconds=("seconds", "mean"),
        seconds_spread=("seconds", "std"),
        device=("device", lambda v: ", ".join(sorted({str(k) for k in v}))),
    )


def _layers(arch: str) -> str:
    return ", ".join(str(k) for k in paper_values.NEURONS.get(arch, ())) or "–"


def _trials(frame: pd.DataFrame) -> str:
    low, high = int(frame["trials"].min()), int(frame["trials"].max())
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"
