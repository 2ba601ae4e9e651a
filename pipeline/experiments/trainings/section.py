"""The section on trainings: the paper's Tables 1 and 3, with its numbers beside ours."""

import math
from collections.abc import Mapping
from typing import Any

import pandas as pd

from pipeline.exhibits.blocks import Column, Picture, Table
from pipeline.exhibits.numbers import count, number
from pipeline.exhibits.planners import BARGAINING, in_order, name_of
from pipeline.exhibits.sections import Section
from pipeline.exhibits.style import Style
from pipeline.experiments import paper
from pipeline.experiments.averages import Average, over_trainings
from pipeline.experiments.trainings.figure import curves_figure


def _in_turn(values: "pd.Series[Any]") -> str:
    return ", ".join(map(str, values))


def _distinct(values: "pd.Series[Any]") -> str:
    return ", ".join(sorted(set(values.dropna().map(str)))) or "–"


AVERAGES = (
    Average("Versions", "versions", over=_in_turn),
    Average("Weights", "parameters", count, over="first"),
    Average("Size (KiB)", "weights_kib", number),
    Average("Instances", "train_instances", count),
    Average("Epochs", "epochs", count),
    Average("Best epoch", "best_epoch", count),
    Average("Validation loss", "valid_loss", number, "valid_loss_spread"),
    Average("Time (s)", "seconds", number, "seconds_spread"),
    Average("Device", "device", over=_distinct),
    Average("Threads", "threads", over=_distinct),
)

COLUMNS = [
    *(Column("Model", "name"), Column("Recipe", "recipe"), AVERAGES[0]),
    *(Column("Neurons (paper)", "paper_neurons"), *AVERAGES[1:8]),
    *(Column("paper (s)", "paper_seconds", number), *AVERAGES[8:]),
]


def section(training: pd.DataFrame, curves: pd.DataFrame, look: Mapping[str, Style]) -> Section:
    """Table of the models and figure of their losses, where they were recorded."""
    values = {
        "refiner": training["arch"].isin(BARGAINING).any(),
        "models": None if training.empty else training_table(training),
        "losses": None if curves.empty else Picture("training", curves_figure(curves, look)),
    }
    return Section("pipeline/experiments/trainings/section.md.jinja", values)


def training_table(training: pd.DataFrame) -> Table:
    """The paper's Tables 1 and 3 for the models that were trained, averaged over their seeds."""
    order = in_order(training["arch"])
    rows = training.assign(recipe=training["recipe"].fillna(""), versions=training["version"])
    frame = over_trainings(rows, ["arch", "recipe"], AVERAGES).sort_values(
        ["arch", "recipe"],
        key=lambda c: c.map(order.index) if c.name == "arch" else c,
        ignore_index=True,
    )
    neurons = [", ".join(map(str, paper.NEURONS.get(arch, ()))) or "–" for arch in frame["arch"]]
    frame = frame.assign(
        name=[name_of(arch) for arch in frame["arch"]],
        paper_neurons=neurons,
        paper_seconds=[paper.TRAIN_SECONDS.get(arch, math.nan) for arch in frame["arch"]],
    )
    return Table("training", frame, COLUMNS, int(frame["seeds"].max()))
