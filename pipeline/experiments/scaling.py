"""Scaling beyond the paper's largest swarm, n = 30: how far each network carries."""

from collections.abc import Mapping
from itertools import takewhile

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, StrMethodFormatter

from pipeline.experiments import paper
from pipeline.experiments.averages import (
    COLLISIONS,
    FUEL_RATIO,
    SAFE,
    SECONDS,
    TRIALS,
    average,
    average_share,
    draw_lines,
    named,
    planner_handles,
    scale,
    summarize,
)
from pipeline.experiments.findings import (
    ANY,
    CHEAP,
    DECOUPLED,
    YES,
    Finding,
    Measured,
    Rules,
    decide,
    groups,
    measured,
    representative,
    rows_of,
    verdict_on,
)
from pipeline.experiments.findings import SAFE as SAFE_SHARE
from pipeline.experiments.rows import PREDICTED
from pipeline.figures.labels import count, in_order, is_papers, number, share
from pipeline.figures.style import PAGE_WIDTH, Style, in_style
from pipeline.figures.tables import Column, Picture, Section, Table

SHOWN = ("expert", "minimum energy", DECOUPLED)
"""Planners that are shown beside networks."""

UNSAFE = average_share(
    *("Unsafe at any time", "unsafe_share"),
    spread="unsafe_spread",
    label="share of unsafe trials",
)
EXCESS = average(
    "Fuel above the bound, av. (%)", "excess", number, label="fuel above the bound, average (%)"
)

DRAWN = (COLLISIONS, UNSAFE, EXCESS, SECONDS)
"""What is drawn against n; of fuel over the bound hundredths count, which a ratio hides."""

COLUMNS = [
    *(Column("n", "n", count), Column("Planner", "name"), Column("Recipe", "recipe")),
    *(TRIALS, COLLISIONS, UNSAFE, FUEL_RATIO, SECONDS),
]


def sections(
    trials: pd.DataFrame, training: pd.DataFrame, look: Mapping[str, Style]
) -> list[Section]:
    """One section, or none where no swarm beyond n = 30 was evaluated.

    Args:
        trials: from ``prepared``.
        training: a row for each trained model.
        look: a style for each planner.
    """
    shown = larger_swarms(trials, training)
    if shown.empty:
        return []
    summary = summarize_larger(shown)
    values = {
        "paper": paper,
        "sizes": sorted({int(n) for n in shown["n"]}),
        "one_speaks": shown["planner"].map(is_papers).any(),
        "safe": share(SAFE_SHARE),
        "cheap": CHEAP,
        "picture": Picture("beyond", scaling_figure(summary, look)),
        "averages": scaling_table(summary),
    }
    return [Section("pipeline/experiments/scaling.md.jinja", values)]


def larger_swarms(trials: pd.DataFrame, training: pd.DataFrame) -> pd.DataFrame:
    """Trials of the sizes above n = 30, and of the largest up to it, of the planners to show.

    These are SHOWN, and networks as they are flown: one for the paper's, by validation (all of
    them where that was not recorded), and every other. There are none without such a size.

    Args:
        trials: from ``prepared``.
        training: a row for each trained model.
    """
    rows = trials[trials["reading"] != PREDICTED]
    sizes = rows["n"].astype(int)
    if not (sizes > paper.LARGEST_SIZE).any():
        return rows.head(0)
    home = sizes[sizes <= paper.LARGEST_SIZE].max()
    kept = [rows[rows["planner"].isin(SHOWN)]]
    for group in groups(rows["planner"]):
        mine = group.of(rows)
        name = representative(mine, training) if group.papers else None
        kept.append(mine if name is None else rows_of(mine, name))
    shown = pd.concat(kept)
    return shown[(shown["n"] > paper.LARGEST_SIZE) | (shown["n"] == home)]


def summarize_larger(trials: pd.DataFrame) -> pd.DataFrame:
    """The columns of ``summarize`` and those of UNSAFE and EXCESS, size by size."""
    summary = summarize(trials)
    low, high = (1 - summary[end] for end in reversed(SAFE.interval or ()))
    excess = 100 * (summary[FUEL_RATIO.source] - 1)
    found = summary.assign(
        unsafe_share=1 - summary[SAFE.source],
        unsafe_spread=summary[SAFE.spread],
        unsafe_low=low,
        unsafe_high=high,
        excess=excess.round(9),  # what decoupled optima need more than the bound is rounding
        excess_spread=100 * summary[FUEL_RATIO.spread],
    )
    return found.sort_values("n", kind="stable", ignore_index=True)


def scaling_table(summary: pd.DataFrame) -> Table:
    """A row for each size and planner, from ``summarize_larger``."""
    return Table("beyond", named(summary), COLUMNS, int(summary["seeds"].max()))


DODGE = 1.025
"""Factor in n by which intervals at one size are moved apart."""


@in_style
def scaling_figure(summary: pd.DataFrame, look: Mapping[str, Style]) -> Figure:
    """A panel for each average of DRAWN against n, on a log scale, from ``summarize_larger``."""
    figure = Figure(figsize=(PAGE_WIDTH, 5.4), layout="constrained")
    panels = list(figure.subplots(2, 2, sharex=True).flat)
    for ax, one in zip(panels, DRAWN, strict=True):
        rows = summary.dropna(subset=[one.source])
        draw_lines(ax, rows, "n", one, look)
        ax.set_ylabel(one.label)
        scale(ax, one, rows[one.source])
    planners = in_order(summary["planner"])
    for row in summary.to_dict("records"):
        k = planners.index(row["planner"]) - (len(planners) - 1) / 2
        at, colour = row["n"] * DODGE**k, look[row["planner"]].colour
        panels[1].vlines(at, row["unsafe_low"], row["unsafe_high"], color=colour, linewidth=0.8)
    for ax in panels[2:]:
        ax.set_xlabel("spacecraft n")
    panels[0].set_xscale("log")
    panels[0].xaxis.set_major_locator(FixedLocator(sorted(set(summary["n"]))))
    panels[0].xaxis.set_major_formatter(StrMethodFormatter("{x:.0f}"))
    panels[0].xaxis.set_minor_locator(NullLocator())
    handles = planner_handles(planners, look)
    figure.legend(handles=handles, loc="outside lower center", ncols=5, handlelength=3)
    return figure


REACH: Rules = (
    ((True, True, ANY), "Carries to n = {last}, the largest tried"),
    ((True, ANY, None), "Carries to n = {last}; too few trials at n = {next}"),
    ((False, ANY, None), "Stays open: too few trials at n = {next}"),
    ((True, ANY, False), "Carries to n = {last} and no further"),
    ((False, ANY, False), "Fails at n = {next}"),
)
"""By whether a network is safe and cheap at the first size, at all, and at the next after those."""


def findings(shown: pd.DataFrame, training: pd.DataFrame) -> list[Finding]:
    """How far each group of networks carries, where swarms beyond n = 30 were evaluated.

    A network carries to a size where it is safe and cheap there and at all sizes before it.

    Args:
        shown: from ``larger_swarms``.
        training: a row for each trained model.
    """
    free = shown[shown["planner"] == DECOUPLED]
    largest = free[free["n"] == free["n"].max()]
    beside = "" if free.empty else f"Own LP at n = {largest['n'].iloc[0]}: {measured(largest).text}"
    found = []
    for group in groups(shown["planner"]):
        rows = group.of(shown)
        if (name := representative(rows, training)) is None:
            continue
        at = {int(str(n)): measured(part) for n, part in rows_of(rows, name).groupby("n")}
        begun = f"How far beyond n = {paper.LARGEST_SIZE} does"
        question = group.question(f"{begun} a network of the paper's", f"{begun} {{}}", "carry?")
        each = "; ".join(f"at n = {n} {one.text}" for n, one in at.items())
        numbers = f"{next(iter(at.values())).name}: {each}"
        found.append(Finding(question, _reach(at), numbers, beside))
    return found


def _reach(at: Mapping[int, Measured]) -> str:
    said = {n: verdict_on(one) for n, one in at.items()}
    kept = list(takewhile(lambda n: said[n] == YES, at))
    following = next((n for n in at if n not in kept), None)
    still_open = following is not None and said[following].startswith("Open")
    claims = bool(kept), following is None, None if still_open else False
    return decide(REACH, *claims).format(last=kept[-1] if kept else "", next=following)
