"""The section on swarms beyond n = 30, where any were evaluated."""

from collections.abc import Mapping

import pandas as pd

from pipeline.exhibits.blocks import Column, Picture, Table
from pipeline.exhibits.numbers import count, share
from pipeline.exhibits.sections import Section
from pipeline.exhibits.style import Style
from pipeline.experiments import paper
from pipeline.experiments.answer import CHEAP, SAFE
from pipeline.experiments.averages import TRIALS
from pipeline.experiments.beyond.figure import beyond_figure
from pipeline.experiments.beyond.rows import shown_beyond
from pipeline.experiments.beyond.summary import UNSAFE, summarize_beyond
from pipeline.experiments.beyond.verdict import carried
from pipeline.experiments.summary import COLLISIONS, FUEL_RATIO, SECONDS, named

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
    shown = shown_beyond(trials, training)
    if shown.empty:
        return []
    summary, speak = summarize_beyond(shown), carried(shown, training)
    values = {
        "paper": paper,
        "sizes": sorted({int(n) for n in shown["n"]}),
        "one_speaks": any(one.group.papers for one in speak),
        "carried": speak,
        "safe": share(SAFE),
        "cheap": CHEAP,
        "picture": Picture("beyond", beyond_figure(summary, look)),
        "exhibit": beyond_table(summary),
    }
    return [Section("pipeline/experiments/beyond/section.md.jinja", values)]


def beyond_table(summary: pd.DataFrame) -> Table:
    """A row for each size and planner, from ``summarize_beyond``."""
    return Table("beyond", named(summary), COLUMNS, int(summary["seeds"].max()))
