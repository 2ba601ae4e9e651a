"""Experiment 4: networks at transfer times that they were not trained for."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pipeline.experiments.averages import (
    SHOWN,
    draw_lines,
    planner_handles,
    prepared,
    scale,
    summarize,
    tables_against,
)
from pipeline.experiments.findings import (
    ANY,
    DECOUPLED,
    TOO_FEW,
    YES,
    Finding,
    Group,
    Rules,
    decide,
    groups,
    measured,
    names_in,
    representative,
    rows_of,
    verdict_on,
)
from pipeline.experiments.rows import NODES, PREDICTED, TIME_STEP, VARIED
from pipeline.experiments.trials import EvaluatedPlanner, run_trials
from pipeline.figures.labels import REFINERS, is_network, ratio, share
from pipeline.figures.style import PAGE_WIDTH, REFERENCE, Style, in_style
from pipeline.figures.tables import Picture, Section, Table
from pipeline.orbit.problem import Problem
from pipeline.progress import SILENT, Progress
from pipeline.scenario import Scenario

PlannersFor = Callable[[Problem], Sequence[EvaluatedPlanner]]
"""Who can take part in a problem: experts and baselines always, networks where they fit."""


@dataclass(frozen=True)
class Variation:
    """A problem that differs from the training's in T or in Δt, which is one of VARIED."""

    varied: str
    problem: Problem


def variations(
    problem: Problem, nodes: Sequence[int], time_steps: Sequence[float] | None = None
) -> list[Variation]:
    """Every T at the Δt of a problem, and every Δt at its T.

    Args:
        problem: that of the training.
        nodes: numbers of nodes T.
        time_steps: Δt in s, or None for those that take as long as the numbers of nodes.

    Raises:
        InputError: for fewer than 3 nodes, or a step that is no positive number.
    """
    if time_steps is None:
        time_steps = [problem.time_step * (T - 1) / problem.intervals for T in nodes]
    return [Variation(NODES, replace(problem, nodes=T)) for T in nodes] + [
        Variation(TIME_STEP, replace(problem, time_step=step)) for step in time_steps
    ]


def run_transfer_times(
    planners_for: PlannersFor,
    scenarios: Sequence[Scenario],
    varied: Sequence[Variation],
    *,
    progress: Progress = SILENT,
) -> pd.DataFrame:
    """All planners that fit, in every variation, on the same initial and goal states.

    The ends stay what they are, since passive formations depend on the orbit alone.

    Args:
        planners_for: who can take part in a problem.
        scenarios: of one problem and one n.
        varied: the problems.
        progress: told of each of them.

    Returns:
        A row a trial: varied, nodes, time_step and the columns of Trial.
    """
    tables = []
    for variation in varied:
        problem = variation.problem
        moved = [replace(scenario, problem=problem) for scenario in scenarios]
        table = run_trials(planners_for(problem), moved)
        for place, name in enumerate(VARIED):
            table.insert(place, name, getattr(problem, name))
        table.insert(0, "varied", variation.varied)
        tables.append(table)
        progress.done(note=f"T = {problem.nodes}, Δt = {problem.time_step:g} s")
    return pd.concat(tables, ignore_index=True)


def summarize_times(times: pd.DataFrame) -> pd.DataFrame:
    """The averages of ``summarize`` by varied, minutes (transfer time), nodes and time_step."""
    return summarize(with_minutes(times), ["varied", "minutes", *VARIED])


def with_minutes(times: pd.DataFrame) -> pd.DataFrame:
    """Trials with their transfer times in minutes."""
    return times.assign(minutes=((times["nodes"] - 1) * times["time_step"] / 60).round(6))


@dataclass(frozen=True)
class TimeGrid:
    """Nodes T and step Δt of a transfer, s."""

    nodes: int
    time_step: float

    @property
    def minutes(self) -> float:
        """The transfer time."""
        return (self.nodes - 1) * self.time_step / 60


def trained_on(times: pd.DataFrame) -> TimeGrid:
    """The training's time grid: the Δt that goes with other T, and the T with other Δt."""
    other_nodes, other_steps = (times[times["varied"] == one] for one in VARIED)
    return TimeGrid(int(other_steps["nodes"].iloc[0]), float(other_nodes["time_step"].iloc[0]))


def rows_varying(summary: pd.DataFrame, varied: str) -> pd.DataFrame:
    """The rows of other T or other Δt, with those at the training's own time, wherever they are."""
    trained, mine = trained_on(summary), summary[summary["varied"] == varied]
    home = (summary["nodes"] == trained.nodes) & (summary["time_step"] == trained.time_step)
    here = (home & (summary["varied"] == varied)).any()
    return mine if here else pd.concat([mine, summary[home]])


PRINTED_MINUTES = {10, 14, 20, 30, 40}
"""Transfer times that the page shows where they were tried; the CSV files have all."""


def section(times: pd.DataFrame, look: Mapping[str, Style]) -> Section:
    """A figure for each recipe, and tables against the transfer time."""
    values: dict[str, Any] = {"tables": {}}
    if not times.empty:
        summary = summarize_times(times)
        values = {
            "refiner": times["planner"].isin(REFINERS).any(),
            "n": times["n"].iloc[0],
            "trials": summary["trials"].max(),
            "trainings": summary["seeds"].max(),
            "pictures": {
                recipe: Picture(
                    f"experiment4-{recipe}".strip("-"), times_figure(summary, recipe, look)
                )
                for recipe in recipes_of(summary)
            },
            "tables": times_tables(summary),
        }
    return Section("pipeline/experiments/experiment4.md.jinja", values)


def times_tables(summary: pd.DataFrame) -> dict[str, Table]:
    """Collisions, share of safe trials and fuel: a column for each of a few transfer times."""
    rows = summary.assign(grid=[_title(row) for _, row in summary.iterrows()])
    printed: list[str] = []
    for varied in VARIED:
        mine = rows[rows["varied"] == varied].sort_values("minutes", kind="stable")
        minutes = sorted(set(mine["minutes"]))
        if len(minutes) > len(PRINTED_MINUTES) + 1:
            mine = mine[mine["minutes"].isin({*PRINTED_MINUTES, minutes[0], minutes[-1]})]
        printed += dict.fromkeys(mine["grid"])
    return tables_against(rows, "experiment4", "grid", {title: title for title in printed})


def _title(row: "pd.Series[Any]") -> str:
    grid = f"T = {row['nodes']}" if row["varied"] == NODES else f"Δt = {row['time_step']:g} s"
    return f"{row['minutes']:.3g} min, {grid}"


def recipes_of(summary: pd.DataFrame) -> list[str]:
    """The recipes of the networks that took part; one without a name where there is none."""
    return sorted(set(summary.loc[summary["planner"].map(is_network), "recipe"])) or [""]


@in_style
def times_figure(summary: pd.DataFrame, recipe: str, look: Mapping[str, Style]) -> Figure:
    """The networks of one recipe, flown, with experts and baselines.

    A row of panels for each average of SHOWN; other T on the left, other Δt on the right. A band
    is the standard deviation between trainings, where there are several.
    """
    mine = ~summary["planner"].map(is_network) | (summary["recipe"] == recipe)
    shown = summary[mine & (summary["reading"] != PREDICTED)]
    trained = trained_on(summary)
    figure = Figure(figsize=(PAGE_WIDTH, 8.2), layout="constrained")
    panels = figure.subplots(len(SHOWN), len(VARIED), sharex=True, sharey="row")
    for line, one in zip(panels, SHOWN.values(), strict=True):
        for ax, varied in zip(line, VARIED, strict=True):
            ax.axvline(trained.minutes, **REFERENCE)
            draw_lines(ax, rows_varying(shown, varied), "minutes", one, look)
        line[0].set_ylabel(one.label)
        scale(line[0], one, shown[one.source])
    panels[0, 0].set_title(f"other T, Δt = {trained.time_step:g} s")
    panels[0, 1].set_title(f"other Δt, T = {trained.nodes}")
    for ax in panels[-1]:
        ax.xaxis.set_major_locator(MaxNLocator(nbins=8, steps=[1, 2, 5, 10]))
        ax.set_xlabel("transfer time (min)")
    handles = planner_handles(shown["planner"], look)
    figure.legend(handles=handles, loc="outside lower center", ncols=4, handlelength=3)
    return figure


SERVED: Rules = (
    ((None, ANY, ANY, ANY), TOO_FEW),
    ((False, ANY, ANY, ANY), "No, not even {home} min"),
    ((True, True, ANY, ANY), "Yes, at every time tried"),
    ((True, False, False, True), "No, at no other time tried"),
    ((True, False, False, False), TOO_FEW),
    ((True, False, True, True), "Only from {served} min"),
    ((True, False, True, False), "From {served} min; else open: too few trials"),
)
"""By whether the training's time is served, all others are, any other is, and the next fail."""


def findings(times: pd.DataFrame, training: pd.DataFrame) -> list[Finding]:
    """Whether each group of networks serves other T, and other Δt, where one took part at all.

    A transfer time is served where plans are proven safe and cheap.

    Args:
        times: a row for each trial at each transfer time.
        training: a row for each trained model.
    """
    if times.empty:
        return []
    trials = prepared(with_minutes(times[times["reading"] != PREDICTED]))
    found = []
    for varied, called in zip(VARIED, ("nodes T", "time steps Δt"), strict=True):
        rows = rows_varying(trials, varied).drop_duplicates(
            ["planner", "recipe", "training_seed", "trial", "minutes"]
        )
        for group in groups(rows["planner"]):
            found += _finding(rows, group, trained_on(times).minutes, training, called)
    return found


def _finding(
    rows: pd.DataFrame, group: Group, trained: float, training: pd.DataFrame, called: str
) -> list[Finding]:
    everywhere, networks = rows["minutes"].nunique(), group.of(rows)
    fits = networks.groupby(["planner", "recipe"])["minutes"].transform("nunique") == everywhere
    name = representative(networks[fits], training)
    if name is None or everywhere < 2:
        return []
    mine = {float(str(at)): part for at, part in rows_of(networks, name).groupby("minutes")}
    free = dict(iter(rows[rows["planner"] == DECOUPLED].groupby("minutes")))
    if trained not in mine:
        return []
    there = measured(mine[trained])
    several, fit = len(names_in(networks)) > 1, len(names_in(networks[fits])) > 1
    how = ", best on validation of those that fit" if fit else ", the only one that fits"
    return [
        Finding(
            group.question(
                *("Does a network of the paper's", "Does {}"),
                f"trained for {trained:g} min serve other {called}?",
            ),
            _served(mine, trained),
            f"{there.name}{how if several else ''}: at {trained:g} min {there.text}; "
            f"{_worst(mine)}",
            f"Own LP: {_worst(free)}" if free else "",
        )
    ]


def _worst(by_time: Mapping[Any, pd.DataFrame]) -> str:
    """The worst of one planner over its transfer times."""
    numbers = {minutes: measured(rows) for minutes, rows in by_time.items()}
    least = min(numbers, key=lambda at: numbers[at].safe)
    dearest = max(numbers, key=lambda at: numbers[at].fuel)
    return (
        f"at worst safe in {share(numbers[least].safe)} ({least:.3g} min) and "
        f"{ratio(numbers[dearest].fuel)} of the bound ({dearest:.3g} min)"
    )


def _served(mine: Mapping[float, pd.DataFrame], trained: float) -> str:
    """The transfer times around the training's, without a gap, that the planner serves."""
    minutes, said = list(mine), [verdict_on(measured(rows)) for rows in mine.values()]
    home = first = last = minutes.index(trained)
    while first > 0 and said[first - 1] == YES:
        first -= 1
    while last < len(said) - 1 and said[last + 1] == YES:
        last += 1
    around = said[max(first - 1, 0) : first] + said[last + 1 : last + 2]
    at_home = True if said[home] == YES else None if said[home].startswith("Open") else False
    fails = all(one.startswith("No") for one in around)
    form = decide(SERVED, at_home, not around, first < last, fails)
    return form.format(home=f"{trained:g}", served=f"{minutes[first]:.3g} to {minutes[last]:.3g}")
