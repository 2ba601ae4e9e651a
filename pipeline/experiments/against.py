"""Tables against a variable: a row for each planner, a column for each of its values."""

from collections.abc import Mapping

import pandas as pd

from pipeline.exhibits.blocks import Column, Table
from pipeline.experiments.averages import Average
from pipeline.experiments.summary import COLLISIONS, FUEL_RATIO, NAMED, PLANNER, SAFE, named
from pipeline.experiments.trials import PREDICTED

SHOWN = {"collisions": COLLISIONS, "safe": SAFE, "fuel": FUEL_RATIO}
"""What is shown against the variable, by what the tables are called."""


def tables_against(
    summary: pd.DataFrame, experiment: str, variable: str, printed: Mapping[str, str]
) -> dict[str, Table]:
    """A table for each average of SHOWN; that of safety without what claims none.

    Args:
        summary: in reading order, which is kept.
        experiment: what the tables' names begin with.
        variable: column with the heading of each row's value in the CSV file.
        printed: what the page shows: by such a heading, its own.
    """
    claimed = summary[summary["reading"] != PREDICTED]
    tables = {}
    for called, average in SHOWN.items():
        rows = claimed if average is SAFE else summary
        frame = _pivot(rows, variable, average)
        columns = [
            Column(
                title,
                heading,
                average.text,
                spread=f"{heading} ±" if f"{heading} ±" in frame else "",
                interval=(f"{heading} low", f"{heading} high") if average.interval else None,
            )
            for heading, title in printed.items()
        ]
        tables[called] = Table(
            f"{experiment}-{called}", named(frame), [*NAMED, *columns], int(rows["seeds"].max())
        )
    return tables


def _pivot(rows: pd.DataFrame, variable: str, average: Average) -> pd.DataFrame:
    # The summary's order is kept: pivoting would sort planners and values by name.
    frame = rows[PLANNER].drop_duplicates()
    headings = list(dict.fromkeys(rows[variable]))
    suffixes = {average.source: ""}
    if average.interval:
        suffixes |= dict(zip(average.interval, (" low", " high"), strict=True))
    if rows[average.spread].notna().any():
        suffixes[average.spread] = " ±"
    for source, suffix in suffixes.items():
        wide = rows.pivot(index=PLANNER, columns=variable, values=source)[headings]
        frame = frame.merge(wide.add_suffix(suffix).reset_index(), on=PLANNER, how="left")
    return frame
