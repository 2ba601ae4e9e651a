"""The section on experiment 3: the paper's Figure 8 for the plain SCP and for the expert."""

from collections.abc import Mapping

import pandas as pd

from pipeline.exhibits.blocks import Block, Picture, Section
from pipeline.exhibits.style import Style
from pipeline.experiments import paper
from pipeline.experiments.experiment3.figure import WHISKERS, optimizers_figure, warmstart_figure
from pipeline.experiments.experiment3.rows import EXPERT, PLAIN
from pipeline.experiments.experiment3.table import warmstart_tables

TITLE = "Experiment 3: warm starts"

OPTIMIZERS = (
    "Seeds are given to two optimizers. The plain SCP is the paper's kind: one cvxpy program, "
    "solved by Clarabel, holds every pair apart at every node, and is aimed anew from each "
    "optimum until the plan no longer improves; it keeps craft apart at the nodes only. Our "
    "expert cuts where craft come close, solves each cluster of craft on its own, and keeps craft "
    "apart at all times. Without a seed the plain SCP starts blank: no pair has a direction of "
    "its own, so all are told to pass radially. The expert starts from each craft's own LP, which "
    "is a seed for the plain SCP. Times are those from scenario to controls on one thread, with "
    "that of the seed."
)

BOXES = (
    f"Boxes are quartiles with the median, whiskers the {WHISKERS[0]}th and {WHISKERS[1]}th "
    "percentile; the dashed line is the median without a seed."
)


def warmstart_section(warmstarts: pd.DataFrame | None, look: Mapping[str, Style]) -> Section:
    """Figures and tables of each optimizer that was run; what is missing says how to get it."""
    if warmstarts is None or warmstarts.empty:
        missing = (
            "No warm starts of these models on these data: `prolearn warmstart` and `prolearn "
            "warmstart --optimizer plain` fill this section."
        )
        return Section(TITLE, [missing])
    return Section(TITLE, [OPTIMIZERS, *_plain(warmstarts, look), *_expert(warmstarts, look)])


def _plain(warmstarts: pd.DataFrame, look: Mapping[str, Style]) -> list[Block]:
    rows = warmstarts[warmstarts["optimizer"] == PLAIN]
    if rows.empty:
        return [
            "The plain SCP was not run: `prolearn warmstart --optimizer plain` sets it beside the "
            "expert."
        ]
    blocks: list[Block] = []
    for table, n in zip(warmstart_tables(warmstarts, PLAIN), _sizes(rows), strict=True):
        caption = (
            f"Time until converged from each seed at n = {n} (the paper's Figure 8): of the plain "
            "SCP, which keeps every pair apart at every node in one program, and of our expert, "
            f"which cuts only where craft come close. {BOXES}"
        )
        if n == paper.NETWORK_SIZE:
            caption += (
                " The paper reports, for its optimizer and machine, roughly "
                f"{paper.NO_SEED_SECONDS:.0f} s without a seed and less than "
                f"{paper.NETWORK_SEED_SECONDS:.0f} s from a network's, a ratio below "
                f"{paper.NETWORK_SEED_SECONDS / paper.NO_SEED_SECONDS:.2f}."
            )
        figure = optimizers_figure(warmstarts, n, look)
        blocks += [Picture(f"experiment3-optimizers-n{n}", caption, figure), table]
    return blocks


def _expert(warmstarts: pd.DataFrame, look: Mapping[str, Style]) -> list[Block]:
    rows = warmstarts[warmstarts["optimizer"] == EXPERT]
    if rows.empty:
        return ["The expert was not run: `prolearn warmstart` sets it beside the plain SCP."]
    blocks: list[Block] = [
        "The expert stops at its first safe plan, or goes on until its best safe plan no longer "
        "improves. The minimum-energy seed costs nothing, so it is what a network's seed has to "
        "beat."
    ]
    for table, n in zip(warmstart_tables(warmstarts, EXPERT), _sizes(rows), strict=True):
        caption = f"Time of the expert from each seed at n = {n}, by stopping rule. {BOXES}"
        figure = warmstart_figure(warmstarts, n, look)
        blocks += [Picture(f"experiment3-n{n}", caption, figure), table]
    return blocks


def _sizes(rows: pd.DataFrame) -> list[int]:
    return sorted(int(n) for n in rows["n"].unique())
