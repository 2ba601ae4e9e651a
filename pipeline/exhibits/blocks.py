"""What a report consists of: sections of sentences, tables and pictures."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import pandas as pd
from matplotlib.figure import Figure

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
        caption: what it shows.
        frame: the numbers.
        columns: what the page shows of them.
    """

    name: str
    caption: str
    frame: pd.DataFrame
    columns: Sequence[Column]

    def markdown(self) -> str:
        """The printed columns as a Markdown table, numbers aligned right."""
        shown = pd.DataFrame({c.title: _texts(self.frame, c) for c in self.columns})
        align = ["left" if c.text is None else "right" for c in self.columns]
        return str(shown.to_markdown(index=False, disable_numparse=True, colalign=align))


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure with its caption.

    Attributes:
        name: name of the figure files, without suffix.
        caption: what it shows.
        figure: the drawing.
    """

    name: str
    caption: str
    figure: Figure


Block = str | Table | Picture


@dataclass(frozen=True, eq=False)
class Section:
    """A heading and what stands below it; a string is a paragraph of Markdown."""

    title: str
    blocks: Sequence[Block]


def _texts(frame: pd.DataFrame, column: Column) -> list[str]:
    values = frame[column.source]
    if column.text is None:
        return [" ".join(str(v).split()).replace("|", "\\|") for v in values]
    texts = [column.text(float("nan") if pd.isna(v) else float(v)) for v in values]
    if column.spread:
        texts = [
            text if pd.isna(spread) else f"{text} ± {column.text(float(spread))}"
            for text, spread in zip(texts, frame[column.spread], strict=True)
        ]
    if column.interval:
        ends = zip(*(frame[end] for end in column.interval), strict=True)
        texts = [
            text if pd.isna(low) else f"{text} {percents(low, high)}"
            for text, (low, high) in zip(texts, ends, strict=True)
        ]
    return texts
