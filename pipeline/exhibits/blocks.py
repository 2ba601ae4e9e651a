"""What a report shows: tables and pictures."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import pandas as pd
from matplotlib.figure import Figure
from tabulate import tabulate

from pipeline.exhibits.numbers import percents


@dataclass(frozen=True)
class Column:
    """One column of a printed table.

    Attributes:
        title: heading, with the unit.
        source: column of the frame.
        text: how a value is written; also decides that the column is aligned right.
        spread: column of the frame that holds the value's spread, where it has one.
        interval: columns that hold the ends of a share's interval, where it has one.
    """

    title: str
    source: str
    text: Callable[[float], str] | None = None
    spread: str = ""
    interval: tuple[str, str] | None = None


@dataclass(frozen=True, eq=False)
class Table:
    """A table, whole in its CSV file and rounded on the page.

    Attributes:
        name: name of the CSV file, without suffix.
        frame: the numbers.
        columns: what the page shows of them.
        trainings: most trainings that a number is the average of.
        printed: for each row whether the page shows it, or None where it shows all.
    """

    name: str
    frame: pd.DataFrame
    columns: Sequence[Column]
    trainings: int = 1
    printed: "pd.Series[bool] | None" = None

    @property
    def markdown(self) -> str:
        """The printed columns as a Markdown table, numbers aligned right."""
        rows = self.frame if self.printed is None else self.frame[self.printed]
        return tabulate(
            list(zip(*(_texts(rows, column) for column in self.columns), strict=True)),
            headers=[column.title for column in self.columns],
            colalign=["left" if column.text is None else "right" for column in self.columns],
            tablefmt="pipe",
            disable_numparse=True,
        )

    @property
    def signs(self) -> str:
        """What brackets and ± mean in it, where it has any."""
        said = []
        if any(column.interval for column in self.columns):
            said.append("Brackets are Wilson's 95 % intervals of a share.")
        if self.trainings > 1:
            said.append(
                f"Networks trained with several seeds (up to {self.trainings}) show the average "
                "of their trainings ± the standard deviation between them."
            )
        return " ".join(said)


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure.

    Attributes:
        name: name of the figure files, without suffix.
        figure: the drawing.
    """

    name: str
    figure: Figure


def _texts(frame: pd.DataFrame, column: Column) -> list[str]:
    values = frame[column.source]
    if column.text is None:
        return [" ".join(str(v).split()).replace("|", "\\|") for v in values]
    texts = []
    for value, (_, row) in zip(values, frame.iterrows(), strict=True):
        text = column.text(float("nan") if pd.isna(value) else float(value))
        if column.spread and pd.notna(row[column.spread]):
            text += f" ± {column.text(float(row[column.spread]))}"
        if column.interval and pd.notna(row[column.interval[0]]):
            text += f" {percents(*row[list(column.interval)])}"
        texts.append(text)
    return texts
