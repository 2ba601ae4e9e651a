"""Table of the trainings, with the paper's numbers beside ours."""

import math
from typing import Any

import pandas as pd

from pipeline.exhibits.blocks import Column, Table
from pipeline.exhibits.numbers import count, number
from pipeline.exhibits.planners import in_order, name_of
from pipeline.experiments import paper
from pipeline.experiments.spread import spread_note


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
        paper_seconds=[paper.TRAIN_SECONDS.get(a, math.nan) for a in frame["arch"]],
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
        Column("Threads", "threads"),
    ]
    caption = (
        "Training of each model beside the paper's layers and training times (its Tables 1 and "
        "3). Losses of different recipes have different targets and do not compare; nor do times "
        "on other numbers of threads."
        f"{spread_note(frame)}"
    )
    return Table("training", caption, frame, columns)


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
        device=("device", _distinct),
        threads=("threads", _distinct),
    )


def _distinct(values: "pd.Series[Any]") -> str:
    return ", ".join(sorted({str(value) for value in values if pd.notna(value)})) or "–"


def _layers(arch: str) -> str:
    return ", ".join(str(k) for k in paper.NEURONS.get(arch, ())) or "–"
