"""Ablations of the refiner: safety and fuel without each of its parts, from stored trials."""

from collections.abc import Mapping
from dataclasses import replace
from math import isnan, nan
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pipeline.experiments import averages, verdicts
from pipeline.experiments.averages import Panel, average
from pipeline.experiments.verdicts import DECOUPLED, Finding, Rules
from pipeline.figures.intervals import Interval
from pipeline.figures.labels import MISSING, count, name_of, number, share
from pipeline.figures.style import GREY, PAGE_WIDTH, REFERENCE, Style, in_style
from pipeline.figures.tables import Column, Picture, Section, Table

TUNED, SHORT = "tuned", "short"
RULE = "rule"

LACKS = {
    TUNED: "nothing",
    SHORT: "most epochs",
    "no-third": "messages of other encounters",
    "uncrowded": "crowded swarms to learn from",
    RULE: "learning",
    DECOUPLED: "rounds",
}
"""What a row lacks, by recipe or planner, in the order of the rows."""

QUESTIONS = {
    "no-third": "Is the refiner worse without messages of other encounters?",
    "uncrowded": "Is the refiner worse without crowded swarms to learn from?",
    RULE: "Is the refiner worse without learning, by its rule alone?",
}
"""Asked of the score over that of ``short``."""

WORSE: Rules = (((True,), "yes"), ((False,), "no, better"), ((None,), "open: within noise"))

UNSAFE = 0.1  # what an unsafe trial counts as in the score, as fuel over the lower bound


def percent(value: float) -> str:
    """A share of the bound in percent, with three significant digits; 0 for rounding."""
    if isnan(value):
        return MISSING
    return "0 %" if abs(value) < 5e-7 else f"{number(100 * value)} %"


def difference(value: float, interval: Interval) -> str:
    """A difference in percent of the bound, with its sign and interval."""
    shown = [f"{100 * one:+.3f}" for one in (value, *interval)]
    shown = [text.lstrip("+-") if float(text) == 0 else text for text in shown]
    return f"{shown[0]} % [{shown[1]}, {shown[2]}]"


UNSAFE_SHARE = average("Unsafe", "unsafe_share", share, "unsafe", spread=True, wilson=True)
EXCESS = average("Fuel over bound, av.", "excess_mean", percent, "excess", spread=True)
SCORE = average("Score, av.", "score_mean", percent, "score", spread=True)

NAMED = [Column("Refiner", "name"), Column("Lacks", "lacks")]
PARTS = [
    *(*NAMED, UNSAFE_SHARE, averages.COLLISIONS, EXCESS),
    *(Column("Score, over short", "against_short"), averages.SECONDS),
]
ROUNDS = [NAMED[0], Column("Rounds", "rounds", count), UNSAFE_SHARE, EXCESS]
"""Columns of the tables of one family and n."""


def section(ablations: pd.DataFrame, look: Mapping[str, Style]) -> Section:
    """Tables for each family and n, and safety and fuel against the number of rounds."""
    values: dict[str, Any] = {"parts": {}}
    if not ablations.empty:
        summary, trials = summarize_ablations(ablations), by_scenarios(scored(ablations))
        each = by_scenarios(summary)
        values = {
            "parts": {at: parts_table(at, trials[at], rows) for at, rows in each.items()},
            "rounds": {at: rounds_table(at, rows) for at, rows in each.items()},
            "own": int(summary["own_rounds"].iloc[0]),
            "trainings": int(summary["seeds"].max()),
            "picture": Picture("ablations", rounds_figure(summary, look)),
            "unsafe": UNSAFE,
        }
    return Section("pipeline/experiments/ablations.md.jinja", values)


def scored(ablations: pd.DataFrame) -> pd.DataFrame:
    """Trials with unsafe as 1 or 0, excess, fuel over the bound less 1, and score.

    The score is what refiners are trained for: the excess, and UNSAFE more where a trial is
    unsafe. Of two planners, one with less excess may just have given way too little.
    """
    rows = averages.prepared(ablations)
    unsafe, excess = 1 - rows["safe"], rows["fuel_ratio"] - 1
    return rows.assign(unsafe=unsafe, excess=excess, score=excess + UNSAFE * unsafe)


def by_scenarios(rows: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """The rows of each family and n, by their label, those of the paper's family first."""
    found = {
        ("" if family == "rings" else f"{family}, ", int(str(n))): part
        for (family, n), part in rows.groupby(["family", "n"])
    }
    return {f"{family}n = {n}": found[family, n] for family, n in sorted(found)}


def summarize_ablations(ablations: pd.DataFrame) -> pd.DataFrame:
    """Averages over the trials of each planner and recipe after each number of rounds.

    Rows have columns family, n, key (recipe or planner), planner, recipe, rounds, own_rounds (those
    of an answer), name, lacks, seeds, trials and averages, in the order of LACKS.
    """
    rows, group = scored(ablations), ["family", "n", "key", "planner", "recipe", "rounds"]
    rows = rows.assign(key=rows["recipe"].where(rows["recipe"] != "", rows["planner"]))
    columns = (UNSAFE_SHARE, averages.COLLISIONS, EXCESS, SCORE, averages.SECONDS)
    summary = averages.averaged(rows, group, columns, {"key": list(LACKS)})
    return summary.assign(
        own_rounds=int(rows["own_rounds"].iloc[0]) if len(rows) else 0,
        name=list(map(_name, summary["planner"], summary["recipe"])),
        lacks=summary["key"].map(LACKS).fillna(""),
    )


def _name(planner: str, recipe: str) -> str:
    if planner == RULE:
        return "Rule alone"
    if not recipe:
        return name_of(planner)
    return recipe if planner == "refiner" else f"{recipe} ({planner})"


def of_answers(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows of answers as they are, with the decoupled optima, which no rounds give."""
    return rows[(rows["rounds"] == rows["own_rounds"]) | (rows["planner"] == DECOUPLED)]


def parts_table(at: str, trials: pd.DataFrame, summary: pd.DataFrame) -> Table:
    """Each refiner at the rounds of its answer, the rule alone and the decoupled optima."""
    frame, trials = of_answers(summary).reset_index(drop=True), of_answers(trials)
    short = trials[trials["recipe"] == SHORT]
    columns = ["score_over_short", "score_low", "score_high"]
    frame = frame.assign(**dict.fromkeys(columns, nan), against_short=MISSING)
    for k, name in enumerate(zip(frame["planner"], frame["recipe"], strict=True)):
        held = verdicts.compare(verdicts.rows_of(trials, name), short, "score")
        if held.trials and name[1] != SHORT:
            frame.loc[k, columns] = held.fuel, *held.fuel_interval
            frame.loc[k, "against_short"] = difference(held.fuel, held.fuel_interval)
    return Table(f"ablations-{_slug(at)}", frame, PARTS)


def rounds_table(at: str, summary: pd.DataFrame) -> Table:
    """A row for tuned, short and the rule after each number of rounds."""
    return Table(f"ablations-rounds-{_slug(at)}", lines_of(summary), ROUNDS)


def _slug(at: str) -> str:
    return at.replace(", ", "-").replace(" = ", "")


def lines_of(summary: pd.DataFrame) -> pd.DataFrame:
    """The rows of tuned, short and the rule, each begun at 0 rounds by the decoupled optima."""
    drawn = summary[summary["key"].isin([TUNED, SHORT, RULE]) & (summary["rounds"] > 0)]
    starts = summary[summary["key"] == DECOUPLED]
    parts = []
    for name, rows in drawn.groupby("name", sort=False):
        parts += [starts.assign(name=name), rows]
    return pd.concat(parts, ignore_index=True)


@in_style
def rounds_figure(summary: pd.DataFrame, look: Mapping[str, Style]) -> Figure:
    """Unsafe trials above, fuel over its bound below; a column for each family and n.

    The dashed line is the number of rounds that an answer takes; a band is the standard deviation
    between trainings, where there are several.
    """
    unsafe = replace(UNSAFE_SHARE, title="unsafe trials (%)", text=number)
    excess = replace(EXCESS, title="fuel over bound, average (%)", text=number)
    lines = lines_of(summary)
    for name in (unsafe.source, unsafe.spread, excess.source, excess.spread):
        lines[name] = 100 * lines[name]
    lines["planner"] = lines["name"]
    named = {name: Style("#E69F00", "s", "--") for name in lines["name"]}
    named |= {TUNED: Style(look["refiner"].colour, "o", "-"), "Rule alone": Style(GREY, "x", ":")}
    parts = by_scenarios(lines)
    grid = [
        [Panel(rows, unsafe, at) for at, rows in parts.items()],
        [Panel(rows[rows["rounds"] > 0], excess) for rows in parts.values()],
    ]
    size = PAGE_WIDTH if len(parts) > 1 else 0.6 * PAGE_WIDTH, 5.2
    figure, axes = averages.lines_figure(grid, ("rounds", "rounds"), named, size)
    for ax in axes.flat:
        ax.axvline(int(summary["own_rounds"].iloc[0]), zorder=1, **REFERENCE)
    axes[0, 0].xaxis.set_major_locator(MaxNLocator(nbins=7, integer=True))
    return figure


def findings(ablations: pd.DataFrame) -> list[Finding]:
    """Whether the refiner is worse without each thing, in score on the same trials."""
    if ablations.empty:
        return []
    on = by_scenarios(of_answers(scored(ablations)))
    found = []
    for key, question in QUESTIONS.items():
        said, numbers = [], []
        for at, rows in on.items():
            mine = rows[(rows["recipe"] == key) | (rows["planner"] == key)]
            short = rows[rows["recipe"] == SHORT]
            held = verdicts.compare(mine, short, "score")
            if held.trials:
                # Beyond chance over the trials, and beyond the spread of trainings
                noise, (low, high) = max(_spread(mine), _spread(short)), held.fuel_interval
                worse = True if low > 0 and held.fuel > noise else None
                worse = False if high < 0 and -held.fuel > noise else worse
                said.append(f"{at}: {verdicts.decide(WORSE, worse)}")
                numbers.append(f"{at}: score {difference(held.fuel, held.fuel_interval)}")
        if said:
            found.append(Finding(question, "; ".join(said), "; ".join(numbers)))
    return found


def _spread(rows: pd.DataFrame) -> float:
    """Standard deviation of the score between trainings; 0 where there is one."""
    each = rows.groupby("training_seed")["score"].mean()
    return float(each.std()) if len(each) > 1 else 0.0
