"""Loss curves of training."""

from collections.abc import Mapping

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pipeline.exhibits.axes import fit_scale
from pipeline.exhibits.planners import BARGAINING, FEED_FORWARD, RECURRENT, in_order, name_of
from pipeline.exhibits.style import GREY, PAGE_WIDTH, Style, in_style


@in_style
def curves_figure(curves: pd.DataFrame, look: Mapping[str, Style]) -> Figure:
    """Training and validation loss against epoch: a row for each recipe, a column a family."""
    families = [
        f for f in ("Feed-forward", "LSTM", "Refiner", "Other") if (_families(curves) == f).any()
    ]
    recipes = sorted(curves["recipe"].fillna("").unique())
    figure = Figure(figsize=(PAGE_WIDTH, 0.9 + 2.1 * len(recipes)), layout="constrained")
    panels = figure.subplots(len(recipes), len(families), squeeze=False)
    for i, recipe in enumerate(recipes):
        for j, family in enumerate(families):
            chosen = (curves["recipe"].fillna("") == recipe) & (_families(curves) == family)
            if not chosen.any():
                panels[i, j].set_axis_off()
                continue
            _panel(panels[i, j], curves[chosen], look)
            panels[i, j].set_title(f"{family}, {recipe} recipe" if recipe else family)
        panels[i, 0].set_ylabel("loss")
    for ax in panels.flat:
        ax.set_xlabel("epoch")
    figure.legend(handles=_legend(curves, look), loc="outside lower center", ncols=4)
    return figure


def _panel(ax: Axes, curves: pd.DataFrame, look: Mapping[str, Style]) -> None:
    for arch in in_order(curves["arch"]):
        colour = look[arch].colour
        for _, rows in curves[curves["arch"] == arch].groupby("training_seed"):
            line = rows.sort_values("epoch")
            ax.plot(line["epoch"], line["train_loss"], color=colour, linewidth=0.8, linestyle=":")
            ax.plot(line["epoch"], line["valid_loss"], color=colour)
    ax.margins(x=0.02)
    ax.xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    losses = curves[["train_loss", "valid_loss"]].to_numpy(dtype=float)
    if (losses >= 0).all():
        fit_scale(ax, "y", losses.ravel(), log=True)


def _families(curves: pd.DataFrame) -> "pd.Series[str]":
    known = {"Feed-forward": FEED_FORWARD, "LSTM": RECURRENT, "Refiner": BARGAINING}
    names = {arch: family for family, archs in known.items() for arch in archs}
    return curves["arch"].map(lambda a: names.get(a, "Other"))


def _legend(curves: pd.DataFrame, look: Mapping[str, Style]) -> list[Line2D]:
    handles = [
        Line2D([], [], color=look[a].colour, label=name_of(a)) for a in in_order(curves["arch"])
    ]
    handles.append(Line2D([], [], color=GREY, label="validation"))
    handles.append(Line2D([], [], color=GREY, linewidth=0.8, linestyle=":", label="training"))
    return handles
