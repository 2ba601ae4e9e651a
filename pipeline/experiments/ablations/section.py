"""The section on ablations: what each idea of the refiner is worth, and each further round."""

from collections.abc import Mapping

import pandas as pd

from pipeline.exhibits.blocks import Column, Picture, Table
from pipeline.exhibits.numbers import MISSING, count
from pipeline.exhibits.sections import Section
from pipeline.exhibits.style import Style
from pipeline.experiments.ablations.figure import lines_of, rounds_figure
from pipeline.experiments.ablations.ground import Ground, grounds
from pipeline.experiments.ablations.summary import (
    EXCESS,
    UNSAFE_SHARE,
    at_own_rounds,
    difference,
    scored,
    summarize_ablations,
)
from pipeline.experiments.ablations.verdict import sentences
from pipeline.experiments.compare import compare
from pipeline.experiments.summary import COLLISIONS, SECONDS
from pipeline.networks.refiner.ablations import EPOCHS, SHORT, UNSAFE

TEMPLATE = "pipeline/experiments/ablations/section.md.jinja"

COLUMNS = [
    *(Column("Refiner", "name"), Column("Lacks", "lacks"), UNSAFE_SHARE, COLLISIONS, EXCESS),
    *(Column("Score, over short", "against_short"), SECONDS),
]
"""What the table on each ground shows."""


def section(ablations: pd.DataFrame, look: Mapping[str, Style]) -> Section:
    """Verdicts, a table for each family and n, and what further rounds make of a plan."""
    if ablations.empty:
        return Section(TEMPLATE, {"grounds": []})
    summary, trials = summarize_ablations(ablations), grounds(scored(ablations))
    values = {
        "sentences": sentences(ablations),
        "grounds": [
            {
                "at": ground.label,
                "other": ground.other,
                "trials": int(rows["trials"].max()),
                "parts": parts_table(ground, trials[ground], rows),
                "rounds": rounds_table(ground, rows),
            }
            for ground, rows in grounds(summary).items()
        ],
        "own": int(summary["own_rounds"].iloc[0]),
        "trainings": int(summary["seeds"].max()),
        "picture": Picture("ablations", rounds_figure(summary, look)),
        "epochs": EPOCHS,
        "unsafe": UNSAFE,
    }
    return Section(TEMPLATE, values)


def parts_table(ground: Ground, trials: pd.DataFrame, summary: pd.DataFrame) -> Table:
    """Each refiner at the rounds that its answer takes, the rule alone and the own LP.

    Args:
        ground: whose rows they are.
        trials: scored.
        summary: of these trials.
    """
    frame, trials = at_own_rounds(summary).reset_index(drop=True), at_own_rounds(trials)
    short = trials[trials["recipe"] == SHORT]
    rows = []
    for planner, recipe in frame[["planner", "recipe"]].itertuples(index=False):
        mine = trials[(trials["planner"] == planner) & (trials["recipe"] == recipe)]
        rows.append(_against(mine, short) if len(short) and recipe != SHORT else {})
    columns = ["score_over_short", "score_low", "score_high", "against_short"]
    frame = frame.join(pd.DataFrame(rows, columns=columns))
    frame["against_short"] = frame["against_short"].fillna(MISSING)
    return Table(f"ablations-{ground.slug}", frame, COLUMNS, int(frame["seeds"].max()))


def _against(mine: pd.DataFrame, short: pd.DataFrame) -> dict[str, float | str]:
    """The difference in score on the same trials."""
    held = compare(mine, short, "score")
    low, high = held.fuel_interval
    text = difference(held.fuel, held.fuel_interval)
    numbers = {"score_over_short": held.fuel, "score_low": low, "score_high": high}
    return {**numbers, "against_short": text}


def rounds_table(ground: Ground, summary: pd.DataFrame) -> Table:
    """A row for each number of rounds: unsafe trials and fuel of tuned, short and the rule."""
    lines = lines_of(summary)
    frame = pd.DataFrame({"rounds": sorted(set(lines["rounds"]))})
    columns = [Column("Rounds", "rounds", count)]
    shown = {"unsafe": UNSAFE_SHARE, "fuel over bound": EXCESS}
    for name in dict.fromkeys(lines["name"]):
        mine = lines[lines["name"] == name].set_index("rounds")
        for title, average in shown.items():
            parts = [average.source, average.spread, *(average.interval or ())]
            frame = frame.join(mine[parts].add_prefix(f"{name} "), on="rounds")
            low, high = average.interval or ("", "")
            columns.append(
                Column(
                    f"{name}, {title}",
                    f"{name} {average.source}",
                    average.text,
                    spread=f"{name} {average.spread}",
                    interval=(f"{name} {low}", f"{name} {high}") if average.interval else None,
                )
            )
    return Table(f"ablations-rounds-{ground.slug}", frame, columns, int(lines["seeds"].max()))
