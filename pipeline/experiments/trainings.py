"""Trainings of the networks: the paper's Tables 1 and 3, and loss curves."""

from collections.abc import Mapping
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pipeline.experiments import paper, verdicts
from pipeline.experiments.averages import Average, aggregate_trainings, average
from pipeline.experiments.verdicts import Finding
from pipeline.figures import labels
from pipeline.figures.labels import REFINERS, architecture_of, count, in_order, name_of, number
from pipeline.figures.style import GREY, PAGE_WIDTH, Style, fit_scale, in_style
from pipeline.figures.tables import Column, Picture, Section, Table


def _distinct(values: "pd.Series[Any]") -> str:
    return ", ".join(sorted(set(values.dropna().map(str)))) or "–"


SECONDS = average("Time (s)", "seconds", number, spread=True)

AVERAGES = (
    Average("Versions", "versions", over_seeds=lambda values: ", ".join(map(str, values))),
    Average("Weights", "parameters", count, over_seeds="first"),
    Average("Size (KiB)", "weights_kib", number),
    Average("Instances", "train_instances", count),
    Average("Epochs", "epochs", count),
    Average("Best epoch", "best_epoch", count),
    average("Validation loss", "valid_loss", number, spread=True),
    SECONDS,
    Average("Device", "device", over_seeds=_distinct),
    Average("Threads", "threads", over_seeds=_distinct),
)

COLUMNS = [
    *(Column("Model", "name"), Column("Recipe", "recipe"), AVERAGES[0]),
    *(Column("Neurons (paper)", "paper_neurons"), *AVERAGES[1:8]),
    *(Column("paper (s)", "paper_seconds", number), *AVERAGES[8:]),
]

FAMILIES = {
    "Feed-forward": labels.FEED_FORWARD,
    "LSTM": labels.RECURRENT,
    "Refiner": REFINERS,
    "Other": {},
}
"""Architectures by their column of the figure; those in no other are in the last."""


def section(training: pd.DataFrame, curves: pd.DataFrame, styles: Mapping[str, Style]) -> Section:
    """Table of the models and figure of their losses, where they were recorded."""
    values = {
        "refiner": training["arch"].map(architecture_of).isin(REFINERS).any(),
        "models": None if training.empty else training_table(training),
        "losses": None if curves.empty else Picture("training", curves_figure(curves, styles)),
    }
    return Section("pipeline/experiments/trainings.md.jinja", values)


def training_table(training: pd.DataFrame) -> Table:
    """The paper's Tables 1 and 3 for the models that were trained, averaged over their seeds."""
    order = {"arch": in_order(training["arch"])}
    rows = training.assign(versions=training["version"])
    frame = aggregate_trainings(rows, ["arch", "recipe"], AVERAGES, order)
    papers = paper.TRAININGS.reindex(frame["arch"].map(architecture_of)).set_index(frame.index)
    frame = frame.assign(name=frame["arch"].map(name_of)).join(papers)
    return Table("training", frame.fillna({"paper_neurons": "–"}), COLUMNS)


@in_style
def curves_figure(curves: pd.DataFrame, styles: Mapping[str, Style]) -> Figure:
    """Training and validation loss against epoch: a row for each recipe, a column a family."""
    known = {arch: family for family, archs in FAMILIES.items() for arch in archs}
    curves = curves.assign(family=[known.get(architecture_of(a), "Other") for a in curves["arch"]])
    families = [family for family in FAMILIES if family in set(curves["family"])]
    recipes = sorted(curves["recipe"].unique())
    figure = Figure(figsize=(PAGE_WIDTH, 0.9 + 2.1 * len(recipes)), layout="constrained")
    panels = figure.subplots(len(recipes), len(families), squeeze=False)
    for line, recipe in zip(panels, recipes, strict=True):
        for ax, family in zip(line, families, strict=True):
            rows = curves[(curves["recipe"] == recipe) & (curves["family"] == family)]
            ax.set_xlabel("epoch")
            if rows.empty:
                ax.set_axis_off()
                continue
            _panel(ax, rows, styles)
            ax.set_title(f"{family}, {recipe} recipe" if recipe else family)
        line[0].set_ylabel("loss")
    handles = [
        Line2D([], [], color=styles[a].colour, label=name_of(a)) for a in in_order(curves["arch"])
    ]
    handles.append(Line2D([], [], color=GREY, label="validation"))
    handles.append(Line2D([], [], color=GREY, linewidth=0.8, linestyle=":", label="training"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure


def _panel(ax: Axes, curves: pd.DataFrame, styles: Mapping[str, Style]) -> None:
    for (arch, _), rows in curves.groupby(["arch", "training_seed"]):
        colour, line = styles[str(arch)].colour, rows.sort_values("epoch")
        marker = "." if len(line) == 1 else ""  # a line of one point would not be seen
        drawn: dict[str, Any] = {"color": colour, "marker": marker}
        ax.plot(line["epoch"], line["train_loss"], linewidth=0.8, linestyle=":", **drawn)
        ax.plot(line["epoch"], line["valid_loss"], **drawn)
    ax.margins(x=0.02)
    ax.xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    losses = curves[["train_loss", "valid_loss"]].to_numpy(dtype=float)
    if (losses >= 0).all():
        fit_scale(ax, "y", losses.ravel(), log=True)


ALIKE = ["device", "threads", "n", "train_instances"]  # columns that are equal where times compare


def findings(training: pd.DataFrame) -> list[Finding]:
    """Whether feed-forward networks train faster than LSTMs by the same recipe on equal data."""
    timed = training.dropna(subset=["seconds"])
    timed = timed[timed["arch"].isin(labels.FEED_FORWARD | labels.RECURRENT)]
    for recipe in ("paper", "tuned", ""):
        rows = timed[timed["recipe"] == recipe]
        if len(rows[ALIKE].drop_duplicates()) != 1:
            continue
        frame = training_table(rows).frame.rename(columns={"arch": "planner"})
        compared = verdicts.compare_families(frame, labels.FEED_FORWARD, labels.RECURRENT, SECONDS)
        if compared is None:
            continue
        verdict, numbers = compared
        quoted = " against ".join(
            labels.span(paper.TRAININGS.loc[list(family), "paper_seconds"])
            for family in (labels.FEED_FORWARD, labels.RECURRENT)
        )
        how = f", {recipe} recipe" if recipe else ""
        question = "Do feed-forward networks train quicker than LSTMs, as in the paper?"
        return [Finding(question, verdict, f"seconds{how}: {numbers} (paper: {quoted})")]
    return []
