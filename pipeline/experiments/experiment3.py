"""Experiment 3: run time of the expert and of a plain SCP by seed (the paper's Figure 8)."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product, starmap
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.experiments import averages, paper, verdicts
from pipeline.experiments.averages import SECONDS, average
from pipeline.experiments.records import CONVERGED, EXPERT, FIRST_SAFE, NO_SEED, OPTIMIZERS, PLAIN
from pipeline.experiments.verdicts import ANY, Finding, Rules, decide, verdict_on_lower
from pipeline.figures import labels
from pipeline.figures.intervals import mean_interval
from pipeline.figures.labels import label_name, number, planner_of, ratio, share, span
from pipeline.figures.style import GREY, PAGE_WIDTH, REFERENCE, Style, fit_scale, in_style
from pipeline.figures.tables import Column, Picture, Section, Table
from pipeline.plan.plan import SOLVED

GROUP = ["optimizer", "n", "rule", "seed"]  # columns that identify a row of the summary

SOLVES = average("Convex solves, av.", "solves_mean", number, "convex_solves")
ONE_SOLVE = average("Done in one", "one_solve_share", share, "one")
MEDIAN = average("Time, median (s)", "seconds_median", number, "seconds", "median")
DEVIATION = average("Time, s.d. (s)", "seconds_deviation", number, "seconds", "std")
ROUNDING = 1e-12  # gaps below are rounding of the arithmetic


def _gap(*value_and_spread: float) -> str:
    """Text of an optimality gap in percent, and of its spread if one is given."""
    return number(*(0.0 if abs(one) < ROUNDING else 100 * one for one in value_and_spread))


GAP = average("Gap, av. (%)", "gap_mean", _gap, "gap", spread=True)
FUEL = average("Fuel, av. (m/s²)", "fuel_mean", number, "fuel")
CLEAR = average("Clear at the nodes", "solved_share", share, "solved", wilson=True)
SAFE = average("Safe at all times", "safe_share", share, "safe", wilson=True)
LOW, HIGH = ENDS = "time_ratio_low", "time_ratio_high"
TIME_RATIO = Column("Time / no seed", "time_ratio", ratio, interval=ENDS, bounds=labels.ratios)

AVERAGES = (SOLVES, ONE_SOLVE, MEDIAN, SECONDS, DEVIATION, GAP, FUEL, CLEAR, SAFE)

SEED = Column("Seed", "name")

COLUMNS = {
    PLAIN: [SEED, SOLVES, ONE_SOLVE, SECONDS, DEVIATION, MEDIAN, TIME_RATIO, GAP, CLEAR, SAFE],
    EXPERT: [Column("Stop", "rule"), SEED, SOLVES, ONE_SOLVE, MEDIAN, TIME_RATIO, GAP, SAFE],
}
"""Columns in the table of each optimizer."""


def section(warmstarts: pd.DataFrame, styles: Mapping[str, Style]) -> Section:
    """Figure and table of each optimizer at each swarm size."""
    values: dict[str, Any] = {"whiskers": WHISKERS, "paper": paper}
    for optimizer in OPTIMIZERS:
        rows = warmstarts[warmstarts["optimizer"] == optimizer]
        values[optimizer] = []
        for n in sorted(map(int, set(rows["n"]))):
            picture = (
                Picture(f"experiment3-optimizers-n{n}", optimizers_figure(warmstarts, n, styles))
                if optimizer == PLAIN
                else Picture(f"experiment3-n{n}", warmstart_figure(warmstarts, n, styles))
            )
            table = warmstart_table(warmstarts, optimizer, n)
            values[optimizer].append({"n": n, "boxes": picture, "seeds": table})
    return Section("pipeline/experiments/experiment3.md.jinja", values)


def warmstart_table(warmstarts: pd.DataFrame, optimizer: str, n: int) -> Table:
    """Each seed under each stopping rule of an optimizer at one swarm size."""
    rows = warmstarts[(warmstarts["optimizer"] == optimizer) & (warmstarts["n"] == n)]
    frame = summarize_warmstarts(rows)
    frame = frame.assign(name=[label_name(seed) for seed in frame["seed"]])
    name = "experiment3-plain" if optimizer == PLAIN else "experiment3"
    return Table(f"{name}-n{n}", frame, COLUMNS[optimizer])


def summarize_warmstarts(warmstarts: pd.DataFrame) -> pd.DataFrame:
    """Averages over the runs of each optimizer, n, rule and seed.

    Rows have columns ``GROUP``, seeds, trials, those of ``AVERAGES`` and of ``time_ratios``;
    infinite gaps are left out.
    """
    gap, solved = warmstarts["optimality_gap"].astype(float), warmstarts["status"] == SOLVED
    rows = warmstarts.assign(
        one=(solved & (warmstarts["convex_solves"] <= 1)).astype(float),
        solved=solved.astype(float),
        safe=averages.as_share(warmstarts["safe"]),
        gap=gap.where(np.isfinite(gap)),
    )
    summary = averages.aggregate(rows, GROUP, AVERAGES, {"seed": seeds_in_order(rows["seed"])})
    return summary.merge(time_ratios(warmstarts), "left", GROUP)


def time_ratios(warmstarts: pd.DataFrame) -> pd.DataFrame:
    """Time from each seed over that without one, on the trials that both solve.

    Rows have columns ``GROUP``, time_ratio, its geometric mean over the trials, and Student's
    interval of it, over the logarithms, as time_ratio_low and time_ratio_high; several trainings
    count as their mean. There is no ratio where an optimizer did not also run without a seed; the
    ratio of that run to itself has no interval.
    """
    each = _solved(warmstarts).groupby([*GROUP, "trial"], as_index=False)["log"].mean()
    unseeded = each[each["seed"] == NO_SEED].drop(columns="seed")
    pairs = each.merge(unseeded, on=[*GROUP[:-1], "trial"], suffixes=("", "_unseeded"))
    pairs["longer"] = pairs["log"] - pairs["log_unseeded"]
    ratios = pairs.groupby(GROUP)["longer"].agg(
        time_ratio=lambda v: v.mean(),
        time_ratio_low=lambda v: mean_interval(v.dropna().to_numpy(dtype=float))[0],
        time_ratio_high=lambda v: mean_interval(v.dropna().to_numpy(dtype=float))[1],
    )
    ratios = np.exp(ratios.astype(float)).reset_index()
    ratios.loc[ratios["seed"] == NO_SEED, list(ENDS)] = np.nan
    return ratios


def _solved(warmstarts: pd.DataFrame) -> pd.DataFrame:
    """Solved runs, with a column log: the logarithm of their seconds. Others are left out."""
    solved = warmstarts[warmstarts["status"] == SOLVED]
    return solved.assign(log=np.log(solved["seconds"].astype(float)))


def seeds_in_order(seeds: Iterable[str]) -> list[str]:
    """Distinct seeds: NO_SEED first, then by planner and recipe."""
    known = set(seeds)
    planners = labels.in_order(map(planner_of, known))
    return sorted(known, key=lambda s: (s != NO_SEED, planners.index(planner_of(s)), s))


WHISKERS = (5, 95)  # percentiles that the whiskers reach to

NAMES = {PLAIN: "Plain SCP", EXPERT: "Our expert"}
UNTIL = {CONVERGED: "until converged", FIRST_SAFE: "until the first safe plan"}
"""Optimizers and stopping rules in words."""


def warmstart_figure(warmstarts: pd.DataFrame, n: int, styles: Mapping[str, Style]) -> Figure:
    """The expert's run times from each seed at swarm size n, a panel for each stopping rule."""
    rows = warmstarts[(warmstarts["n"] == n) & (warmstarts["optimizer"] == EXPERT)]
    panels = {f"n = {n}, {UNTIL[str(rule)]}": part for rule, part in rows.groupby("rule")}
    return _boxes_figure(panels, styles)


def optimizers_figure(warmstarts: pd.DataFrame, n: int, styles: Mapping[str, Style]) -> Figure:
    """Run times until converged from each seed at swarm size n, a panel for each optimizer."""
    rows = warmstarts[(warmstarts["n"] == n) & (warmstarts["rule"] == CONVERGED)]
    parts = {name: rows[rows["optimizer"] == optimizer] for optimizer, name in NAMES.items()}
    panels = {f"{name}, n = {n}": part for name, part in parts.items() if len(part)}
    return _boxes_figure(panels, styles)


@in_style
def _boxes_figure(panels: Mapping[str, pd.DataFrame], styles: Mapping[str, Style]) -> Figure:
    """A panel of boxes for each title, on common axes; a seed without a box was not run."""
    seeds = seeds_in_order(pd.concat(list(panels.values()))["seed"])
    figure = Figure(figsize=(PAGE_WIDTH, 0.9 + 0.24 * len(seeds)), layout="constrained")
    axes = figure.subplots(1, len(panels), sharey=True, sharex=True, squeeze=False)[0]
    spans = []
    for ax, (title, part) in zip(axes, panels.items(), strict=True):
        _boxes(ax, part, seeds, styles)
        ax.set_title(title)
        ax.set_xlabel("time per instance (s)")
        spans.append(part.groupby("seed")["seconds"].quantile(np.array(WHISKERS) / 100).dropna())
    fit_scale(axes[0], "x", np.concatenate(spans), log=True)
    axes[0].set_yticks(range(len(seeds)), [label_name(s) for s in seeds])
    axes[0].set_ylim(len(seeds) - 0.5, -0.5)
    return figure


def _boxes(ax: Axes, rows: pd.DataFrame, seeds: list[str], styles: Mapping[str, Style]) -> None:
    times = {s: rows.loc[rows["seed"] == s, "seconds"].dropna().to_numpy() for s in seeds}
    shown = ax.boxplot(
        list(times.values()),
        positions=range(len(seeds)),
        orientation="horizontal",
        whis=WHISKERS,
        showfliers=False,
        widths=0.62,
        patch_artist=True,
        manage_ticks=False,
        medianprops={"color": "black", "linewidth": 1.4},
        whiskerprops={"color": GREY, "linewidth": 0.8},
        capprops={"color": GREY, "linewidth": 0.8},
    )
    for box, seed in zip(shown["boxes"], seeds, strict=True):
        colour = "#FFFFFF" if seed == NO_SEED else styles[planner_of(seed)].colour
        box.set(facecolor=colour, edgecolor=GREY, linewidth=0.7)
    if len(unseeded := times.get(NO_SEED, ())):
        ax.axvline(float(np.median(unseeded)), zorder=0.5, **REFERENCE)
    ax.grid(axis="y", visible=False)
    ax.tick_params(axis="y", length=0)


LINE = "straight line"  # a seed

PAPERS: Rules = (
    ((True, ANY, True), "Yes for the paper's kind of optimizer, compared with no seed"),
    ((True, True, ANY), "No for the paper's kind of optimizer"),
    ((ANY, ANY, ANY), "Open for the paper's kind of optimizer"),
)
"""By whether there are several trainings, and all seeds slow the plain SCP down or speed it up."""

OURS: Rules = (
    ((True, ANY), "none saves time"),
    ((ANY, True), "some save time"),
    ((ANY, ANY), "no saving is proven"),
)
"""By whether all seeds slow our expert down, and whether any speeds it up."""


def findings(warmstarts: pd.DataFrame) -> Iterator[Finding]:
    """Whether the plans of each group of networks speed up the optimizers that they seed."""
    runs = warmstarts.assign(planner=warmstarts["seed"].map(planner_of))
    ratios = time_ratios(pd.concat([_converged(runs, name) for name in NAMES]))
    ratios["planner"] = ratios["seed"].map(planner_of)
    baseline = "; ".join(starmap(_seed_ratios, _by_optimizer(ratios).items()))
    for group in verdicts.groups(set(runs["planner"]) - {NO_SEED}):
        mine = _by_optimizer(group.of(ratios))
        if not mine:
            continue
        several = len(group.of(runs)[["seed", "training_seed"]].drop_duplicates()) > 1
        verdict_parts = []
        if PLAIN in mine:
            plain = mine[PLAIN]
            costly, saving = bool((plain[LOW] > 1).all()), bool((plain[HIGH] < 1).all())
            verdict_parts.append(decide(PAPERS, several, costly, saving))
        if EXPERT in mine:
            ours = mine[EXPERT]
            costly, saving = bool((ours[LOW] > 1).all()), bool((ours[HIGH] < 1).any())
            verdict_parts.append(f"with ours, {decide(OURS, costly, saving)}")
        predicate = "plans speed up the optimizer that they seed?"
        question = group.question(predicate, "Do the paper's networks'", "Do {}'s")
        numbers = "; ".join(
            f"{NAMES[name]}: {span(found['time_ratio'])} of the time without a seed, "
            f"{(found[HIGH] < 1).sum()} of {len(found)} networks faster beyond chance "
            f"(n = {found['n'].iloc[0]})"
            for name, found in mine.items()
        )
        text = "; ".join(verdict_parts)
        yield Finding(question, text[0].upper() + text[1:], numbers, baseline)


def paper_findings(warmstarts: pd.DataFrame) -> Iterator[Finding]:
    """Whether the paper's claims on its networks' seeds hold, for the plain SCP.

    The variation of times is their mean deviation from the median of their seed (M. Brown,
    A. Forsythe, "Robust tests for the equality of variances", Journal of the American Statistical
    Association 69, 1974). Seeds are compared on the trials that both solve.
    """
    rows = _solved(_converged(warmstarts, PLAIN))
    networks = rows[rows["seed"].map(planner_of).map(labels.is_of_paper).astype(bool)]
    if networks.empty:
        return
    several = bool(networks.groupby("seed")["training_seed"].nunique().min() > 1)
    seconds = rows["seconds"].astype(float)
    median = seconds.groupby([rows["seed"], rows["training_seed"]]).transform("median")
    each = rows.assign(away=(seconds - median).abs())
    away, logs = (each.pivot_table(name, "trial", "seed") for name in ("away", "log"))
    seeds = seeds_in_order(networks["seed"])
    line = [(seed, LINE) for seed in seeds if LINE in away]
    # FFcol's beside those of the other networks by its recipe
    best = [
        (seed, other)
        for seed, other in product(seeds, seeds)
        if planner_of(seed) == "ffcol"
        and planner_of(other) != "ffcol"
        and seed.removeprefix("ffcol") == other.removeprefix(planner_of(other))
    ]
    steady = "Do times vary less from networks' seeds than from the straight line, as in the paper?"
    quick = "Is FFcol's the quickest seed of the networks', as in the paper?"
    on_pairs = partial(_on_pairs, n=int(rows["n"].iloc[0]), several=several)
    yield from on_pairs(steady, line, away, away.mean(), "mean deviation from the median")
    yield from on_pairs(quick, best, logs, np.exp(logs.mean()), "geometric mean")


def _on_pairs(
    question: str,
    pairs: Sequence[tuple[str, str]],
    values: pd.DataFrame,
    shown: "pd.Series[float]",
    name: str,
    *,
    n: int,
    several: bool,
) -> Iterator[Finding]:
    """The finding on whether times from the first seed of each pair are lower; none without pairs.

    Values are by trial (rows) and seed (columns); ``shown`` is the statistic of each seed that the
    finding quotes, s, and ``name`` its name.
    """
    if not pairs:
        return
    lower = [mean_interval((values[a] - values[b]).dropna().to_numpy()) for a, b in pairs]
    ours, others = (span(shown[list(set(side))]) for side in zip(*pairs, strict=True))
    numbers = (
        f"{NAMES[PLAIN]}, {name}: {ours} s against {others} s, "
        f"{sum(high < 0 for _, high in lower)} of {len(pairs)} pairs lower beyond chance (n = {n})"
    )
    yield Finding(question, verdict_on_lower(several, lower), numbers)


def _by_optimizer(rows: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """The rows of each optimizer that has any."""
    return {name: part for name in NAMES if len(part := rows[rows["optimizer"] == name])}


def _converged(warmstarts: pd.DataFrame, optimizer: str) -> pd.DataFrame:
    """An optimizer's runs until converged, at the swarm size that is nearest to the paper's."""
    rows = warmstarts[(warmstarts["optimizer"] == optimizer) & (warmstarts["rule"] == CONVERGED)]
    return rows if rows.empty else rows[rows["n"] == averages.reference_size(rows)]


def _seed_ratios(optimizer: str, ratios: pd.DataFrame) -> str:
    """Time ratios of the seeds that are no network's, as text."""
    listed = [
        f"{label_name(seed)} {ratio(value)}"
        for seed, value in zip(ratios["seed"], ratios["time_ratio"], strict=True)
        if seed != NO_SEED and not labels.is_network(planner_of(seed))
    ]
    return f"{NAMES[optimizer]}: {', '.join(listed)}"
