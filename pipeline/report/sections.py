"""The sections of the report, in the paper's order; what is missing says how to get it."""

from collections.abc import Mapping

import pandas as pd

from pipeline.exhibits.blocks import Block, Picture, Section
from pipeline.exhibits.planners import planner_of
from pipeline.exhibits.style import Style, styles
from pipeline.experiments import paper
from pipeline.experiments.examples.figure import figure_transfer
from pipeline.experiments.experiment1.figure import objectives_figure
from pipeline.experiments.experiment1.table import objectives_table
from pipeline.experiments.experiment2 import figure as figures_scaling
from pipeline.experiments.experiment2.figure import scaling_figure
from pipeline.experiments.experiment2.table import scaling_tables
from pipeline.experiments.experiment3.section import warmstart_section
from pipeline.experiments.experiment4.averages import summarize_times
from pipeline.experiments.experiment4.figure import recipes_of, times_figure
from pipeline.experiments.experiment4.table import times_tables
from pipeline.experiments.trainings.figure import curves_figure
from pipeline.experiments.trainings.table import training_table
from pipeline.report.provenance import provenance_table
from pipeline.report.results import Results, is_empty

READINGS = (
    "A network is read twice. *As predicted* is the paper's reading: its raw states, which need "
    "neither obey the dynamics nor meet the ends, so their fuel is not comparable and no safety "
    "is claimed. *Flown* is the nearest trajectory that obeys the dynamics and both ends exactly. "
    "Experts and baselines are plans as they stand."
)


def all_sections(results: Results, summary: pd.DataFrame, n: int) -> list[Section]:
    """Every section, for the summary of the trials and the swarm size of experiment 1."""
    look = _look(results)
    return [
        _experiment1(summary, n, look),
        _training(results, look),
        _experiment2(summary, look),
        warmstart_section(results.warmstarts, look),
        _experiment4(results, look),
        _examples(results),
        _provenance(results),
    ]


def _look(results: Results) -> dict[str, Style]:
    """One style for each planner of any table, so that it looks the same in every figure."""
    names = {str(p) for p in results.trials["planner"]}
    for table in (results.training, results.curves):
        if table is not None and not table.empty:
            names |= {str(a) for a in table["arch"]}
    if results.transfer_times is not None and not results.transfer_times.empty:
        names |= {str(p) for p in results.transfer_times["planner"]}
    if results.warmstarts is not None and not results.warmstarts.empty:
        names |= {planner_of(str(s)) for s in results.warmstarts["seed"]} - {"none"}
    return styles(names)


def _experiment1(summary: pd.DataFrame, n: int, look: Mapping[str, Style]) -> Section:
    blocks: list[Block] = [READINGS]
    if n != paper.NETWORK_SIZE:
        blocks.append(
            f"No trial has n = {paper.NETWORK_SIZE}; this section uses n = {n}, the nearest "
            "size evaluated, so the paper's own numbers do not stand beside ours."
        )
    caption = (
        f"Average collisions and fuel of each planner at n = {n} (the paper's Figures 2 and 3). "
        "Experts and baselines in black, grey and dark tones, feed-forward networks in cool and "
        "LSTMs in warm colours."
    )
    picture = Picture("experiment1", caption, objectives_figure(summary, n, look))
    return Section(
        f"Experiment 1: {n} spacecraft", [*blocks, objectives_table(summary, n), picture]
    )


def _training(results: Results, look: Mapping[str, Style]) -> Section:
    blocks: list[Block] = []
    if results.training is None or is_empty(results.training):
        blocks.append("No training runs were recorded: `prolearn train` fills this table.")
    else:
        blocks.append(training_table(results.training))
    if results.curves is None or is_empty(results.curves):
        blocks.append("No loss curves were recorded: `prolearn train` writes them.")
    else:
        caption = "Loss against epoch: validation solid, training dotted."
        blocks.append(Picture("training", caption, curves_figure(results.curves, look)))
    return Section("Training", blocks)


def _experiment2(summary: pd.DataFrame, look: Mapping[str, Style]) -> Section:
    title = "Experiment 2: other swarm sizes"
    if summary["n"].nunique() < 2:
        return Section(
            title,
            [
                f"Only n = {summary['n'].iloc[0]} was evaluated: `prolearn evaluate --n 2..30` "
                "fills this section."
            ],
        )
    hollow = (
        "Hollow markers are the paper's values at n = 10 (its Table 2) and n = 30 (its text), "
        "set apart sideways where they would hide each other."
    )
    drawn = [
        ("collisions", figures_scaling.COLLISIONS, "Node collisions (Eq. 5)", "4", hollow),
        ("safe", figures_scaling.SAFE, "Share of trials safe at all times", "", ""),
        ("fuel", figures_scaling.FUEL, "Fuel (Eq. 4)", "5", hollow),
        (
            "seconds",
            figures_scaling.SECONDS,
            "Time to plan one instance",
            "6 and 7",
            "The hollow marker is the paper's optimizer at n = 30, nearly "
            f"{paper.EXPERT_SECONDS_AT_30:.0f} s; its networks take at most "
            f"{paper.NETWORK_SECONDS}. Its machine and programs are not ours. All planners "
            "ran on one thread, in turn on the same scenarios.",
        ),
    ]
    pictures = [
        Picture(
            f"experiment2-{name}",
            f"{what} against n"
            + (f" (the paper's Figure{'s' * (len(paper) > 1)} {paper})" if paper else "")
            + f". {note}".rstrip(),
            scaling_figure(summary, quantity, look),
        )
        for name, quantity, what, paper, note in drawn
        if summary[quantity.value].notna().any()
    ]
    blocks: list[Block] = [*pictures, *scaling_tables(summary)]
    if summary["seconds_mean"].isna().all():
        blocks.append("No planner was timed: `prolearn evaluate` records run times.")
    return Section(title, blocks)


def _experiment4(results: Results, look: Mapping[str, Style]) -> Section:
    title = "Experiment 4: other transfer times"
    times = results.transfer_times
    if times is None or times.empty:
        return Section(
            title,
            [
                "No other transfer times of these models on these data: `prolearn transfer-times` "
                "fills this section."
            ],
        )
    summary = summarize_times(times)
    several = bool((summary["seeds"] > 1).any())
    bands = " Bands are the standard deviation between trainings." if several else ""
    pictures = [
        Picture(
            f"experiment4-{recipe}" if recipe else "experiment4",
            "Node collisions (Eq. 5), share of trials safe at all times and fuel over its bound "
            "against the transfer time"
            + (f"; networks of the {recipe} recipe, flown" if recipe else "")
            + ". The dashed line is the transfer time of the training. More nodes are more "
            "occasions to collide at one."
            f"{bands}",
            times_figure(summary, recipe, look),
        )
        for recipe in recipes_of(summary)
    ]
    trials = int(summary["trials"].max())
    about = (
        f"The paper announces this experiment and reports no results. {trials:,} test scenarios of "
        f"n = {times['n'].iloc[0]} keep their ends, and the transfer takes another time: with "
        "other T at the Δt of the training, or with other Δt at its T. No network was trained "
        "anew. LSTMs take any T; feed-forward networks are 6nT numbers wide, so they take part at "
        "one T alone. None of the paper's networks reads Δt."
    )
    return Section(title, [about, *pictures, *times_tables(summary)])


def _examples(results: Results) -> Section:
    title = "Example transfers"
    if not results.examples:
        return Section(title, ["No example was kept: `prolearn evaluate` keeps some to draw."])
    return Section(
        title,
        [
            Picture(
                f"transfer-{k}",
                f"{example.title} (compare the paper's Figures 1 and 9). All panels have the same "
                "equal scale; thin ellipses are the initial and goal orbits.",
                figure_transfer(example),
            )
            for k, example in enumerate(results.examples, start=1)
        ],
    )


def _provenance(results: Results) -> Section:
    if results.provenance is None or results.provenance.empty:
        return Section("Provenance", ["Nothing is known about how these results were made."])
    return Section("Provenance", [provenance_table(results.provenance)])
