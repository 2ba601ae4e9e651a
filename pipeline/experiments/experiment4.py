"""Experiment 4: networks at transfer times that they were not trained for."""

from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pipeline.experiments import averages, verdicts
from pipeline.experiments.averages import SHOWN, Panel
from pipeline.experiments.records import NODES, PREDICTED, TIME_STEP, VARIED
from pipeline.experiments.verdicts import Finding, Performance, performance
from pipeline.figures import labels
from pipeline.figures.labels import REFINERS, is_network, percents, ratio_within, share
from pipeline.figures.style import PAGE_WIDTH, REFERENCE, Style, in_style
from pipeline.figures.tables import Picture, Section, Table


def summarize_times(times: pd.DataFrame) -> pd.DataFrame:
    """The averages of ``summarize`` by varied, minutes (transfer time), nodes and time_step."""
    rounded = times.assign(minutes=_minutes(times).round(6))
    return averages.summarize(rounded, ["varied", "minutes", *VARIED])


def _minutes(times: pd.DataFrame) -> "pd.Series[float]":
    return (times["nodes"] - 1) * times["time_step"] / 60


def grid_of_data(times: pd.DataFrame) -> tuple[int, float]:
    """T and Δt (s) of the data: the T of rows with other Δt, the Δt of those with other T.

    All networks were trained with these but refiners, which may take part on any data.
    """
    other_nodes, other_steps = (times[times["varied"] == one] for one in VARIED)
    return int(other_steps["nodes"].iloc[0]), float(other_nodes["time_step"].iloc[0])


def rows_varying(summary: pd.DataFrame, varied: str) -> pd.DataFrame:
    """The rows of other T, or of other Δt, with those of the data's T and Δt."""
    nodes, time_step = grid_of_data(summary)
    home = (summary["nodes"] == nodes) & (summary["time_step"] == time_step)
    mine = summary["varied"] == varied
    return summary[mine] if (home & mine).any() else pd.concat([summary[mine], summary[home]])


PRINTED_MINUTES = {10, 14, 20, 30, 40}  # columns of the page, if evaluated; the CSV files have all


def section(times: pd.DataFrame, styles: Mapping[str, Style]) -> Section:
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
                one: Picture(f"experiment4-{one}".strip("-"), times_figure(summary, one, styles))
                for one in recipes_of(summary)
            },
            "tables": times_tables(summary),
        }
    return Section("pipeline/experiments/experiment4.md.jinja", values)


def times_tables(summary: pd.DataFrame) -> dict[str, Table]:
    """Collisions, share of safe trials and fuel: a column for each of a few transfer times."""
    steps = labels.distinct_texts(summary["time_step"], 6)
    rows = summary.assign(grid=[_title(row, steps) for _, row in summary.iterrows()])
    printed: list[str] = []
    for varied in VARIED:
        mine = rows[rows["varied"] == varied].sort_values("minutes", kind="stable")
        shown = averages.printed_values(mine["minutes"], PRINTED_MINUTES)
        printed += dict.fromkeys(mine.loc[mine["minutes"].isin(shown), "grid"])
    return averages.tables_against(rows, "experiment4", "grid", {title: title for title in printed})


def _title(row: "pd.Series[Any]", steps: Mapping[float, str]) -> str:
    step = steps[row["time_step"]]
    grid = f"T = {row['nodes']}" if row["varied"] == NODES else f"Δt = {step} s"
    return f"{row['minutes']:.3g} min, {grid}"


def recipes_of(summary: pd.DataFrame) -> list[str]:
    """The recipes of the networks that took part; one empty recipe if there are none."""
    return sorted(set(summary.loc[summary["planner"].map(is_network), "recipe"])) or [""]


@in_style
def times_figure(summary: pd.DataFrame, recipe: str, styles: Mapping[str, Style]) -> Figure:
    """The networks of one recipe, flown, with experts and baselines.

    A row of panels for each average of SHOWN; other T on the left, other Δt on the right.
    """
    mine = ~summary["planner"].map(is_network) | (summary["recipe"] == recipe)
    shown = summary[mine & (summary["reading"] != PREDICTED)]
    nodes, time_step = grid_of_data(summary)
    titles = {NODES: f"other T, Δt = {time_step:g} s", TIME_STEP: f"other Δt, T = {nodes}"}
    grid = [
        [Panel(rows_varying(shown, varied), avg, "" if k else titles[varied]) for varied in VARIED]
        for k, avg in enumerate(SHOWN.values())
    ]
    against = "minutes", "transfer time (min)"
    figure, axes = averages.lines_figure(grid, against, styles, (PAGE_WIDTH, 8.2), sharey="row")
    for ax in axes.flat:
        ax.axvline((nodes - 1) * time_step / 60, **REFERENCE)
    axes[0, 0].xaxis.set_major_locator(MaxNLocator(nbins=8, steps=[1, 2, 5, 10]))
    return figure


def findings(times: pd.DataFrame, training: pd.DataFrame) -> Iterator[Finding]:
    """Whether each group of networks that took part is safe and cheap at other T, at other Δt."""
    if times.empty:
        return
    trials = averages.prepared(times[times["reading"] != PREDICTED])
    trials = trials.assign(minutes=_minutes(trials))
    nodes, time_step = grid_of_data(times)
    home = f"transfers of {(nodes - 1) * time_step / 60:g} min"
    for varied, called in zip(VARIED, ("nodes T", "time steps Δt"), strict=True):
        rows = rows_varying(trials, varied).drop_duplicates(
            ["planner", "recipe", "training_seed", "trial", "minutes"]
        )
        work = f"work with other {called}"
        trained_for = f"trained for {home} {work}?"
        everywhere = rows["minutes"].nunique()
        decoupled = _by_time(rows[rows["planner"] == verdicts.DECOUPLED])
        baseline = f"Decoupled optimum: {_worst(decoupled)}" if decoupled else ""
        for group in verdicts.groups(rows["planner"]):
            networks = group.of(rows)
            times_of = networks.groupby(["planner", "recipe"])["minutes"].transform("nunique")
            fits = networks[times_of == everywhere]
            name = verdicts.representative(fits, training)
            if name is None or everywhere < 2:
                continue
            at = _by_time(verdicts.rows_of(networks, name))
            several, fit = (len(verdicts.networks_in(some)) > 1 for some in (networks, fits))
            how = ", best on validation of those that fit" if fit else ", the only one that fits"
            numbers = f"{next(iter(at.values())).name}{how if several else ''}: {_worst(at)}"
            verdict = verdicts.where_safe_and_cheap(at)
            # A refiner may have been trained on another time grid.
            predicate = f"{work} than the data's?" if name[0] in REFINERS else trained_for
            yield Finding(group.question(predicate), verdict, numbers, baseline)


def _by_time(rows: pd.DataFrame) -> dict[str, Performance]:
    texts = sorted(labels.distinct_texts(rows["minutes"], 3).items())
    return {f"{text} min": performance(rows[rows["minutes"] == at]) for at, text in texts}


def _worst(at: Mapping[str, Performance]) -> str:
    least, dearest = min(at, key=lambda t: at[t].safe), max(at, key=lambda t: at[t].fuel)
    safe = f"{share(at[least].safe)} {percents(*at[least].safe_interval)}"
    fuel = ratio_within(at[dearest].fuel, at[dearest].fuel_interval)
    return f"at worst safe in {safe} ({least}) and at {fuel} of the bound ({dearest})"
