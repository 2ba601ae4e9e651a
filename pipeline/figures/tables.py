"""Tables, figures and sections of a report, and how they are written."""

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from pipeline.figures.labels import percents
from pipeline.files import write_rows
from pipeline.markup import Markdown, table, template

INTERVALS = "Brackets are 95 % intervals: Wilson's of a share, Student's of a mean."

LONGEST = 80  # characters of a file's name that a table or figure keeps of its own


@dataclass(frozen=True)
class Column:
    """One column of a printed table."""

    title: str  # with the unit
    source: str  # column of the frame
    text: Callable[..., str] | None = None  # formats a number and any spread; aligned right
    spread: str = ""  # column of the frame with its spread between trainings
    interval: tuple[str, str] | None = None  # columns with the ends of its interval
    bounds: Callable[[float, float], str] = percents  # formats these


@dataclass(frozen=True, eq=False)
class Table:
    """A table: complete in its CSV file; on the page some columns, rounded."""

    name: str  # of the CSV file
    frame: pd.DataFrame
    columns: Sequence[Column]  # that the page shows
    printed: "pd.Series[bool] | None" = None  # whether the page shows a row; all by default

    @property
    def markdown(self) -> Markdown:
        """The printed columns as a Markdown table, numbers aligned right."""
        rows = self.frame if self.printed is None else self.frame[self.printed]
        return table(
            [column.title for column in self.columns],
            zip(*(_texts(rows, column) for column in self.columns), strict=True),
            right=[k for k, column in enumerate(self.columns) if column.text is not None],
        )

    @property
    def notation(self) -> str:
        """What brackets and ± mean, if the table has any."""
        said = [INTERVALS] if any(column.interval for column in self.columns) else []
        spreads = [column.spread for column in self.columns if column.spread]
        if self.frame[spreads].notna().any(axis=None):
            said.append(
                "Networks trained with several seeds show the average of their trainings ± the "
                "standard deviation between them."
            )
        return " ".join(said)


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure, and the name of its files."""

    name: str
    figure: Figure


@dataclass(frozen=True, eq=False)
class Section:
    """Text with tables and figures in it.

    A template places them by ``{% call table(x) %}caption{% endcall %}`` and
    ``{% call figure(x) %}caption{% endcall %}``; empty lines separate its paragraphs.
    """

    template: str  # path, as for ``pipeline.markup.template``
    values: Mapping[str, Any]  # of the names in the template


class Writer:
    """Writes sections, one after another, and numbers their tables and figures."""

    def __init__(self) -> None:
        self.tables: list[Table] = []
        self.pictures: list[Picture] = []

    def write(self, section: Section) -> Markdown:
        """The section's Markdown, each paragraph and each item of a list on a line of its own."""
        given = {**section.values, "table": self._table, "figure": self._figure}
        text = template(section.template).render(given)
        parts = filter(None, map(str.strip, re.split(r"\n\s*\n", text)))
        return Markdown("\n\n".join(map(_joined, parts)))

    def _table(self, table: Table, caller: Callable[[], str]) -> str:
        self.tables.append(table)
        caption = f"{caller().strip()} {table.notation}".strip()
        return f"*Table {len(self.tables)}. {caption}*\n\n{table.markdown}\n\n"

    def _figure(self, picture: Picture, caller: Callable[[], str]) -> str:
        self.pictures.append(picture)
        k, caption = len(self.pictures), " ".join(caller().split())
        return f"![Figure {k}](figures/{file_name(picture.name)}.svg)\n*Figure {k}. {caption}*\n\n"


def write_csv(frame: pd.DataFrame, path: Path) -> None:
    """Write a table as CSV, which appears whole; invisible characters become escapes."""
    known = frame.astype(object).where(frame.notna(), None)
    write_rows(path, frame.columns, known.itertuples(index=False))


def file_name(name: str) -> str:
    """A name as a file name; where it has other characters or is long, its digest ends it."""
    plain = re.sub(r"[^A-Za-z0-9_.-]+", "-", name)[:LONGEST]
    return plain if plain == name else f"{plain}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"


def _joined(part: str) -> str:
    """Join the lines of a Markdown paragraph or list item; tables and figures are unchanged."""
    if part.startswith(("|", "!")):
        return part
    items = part.split("\n- ") if part.startswith("- ") else [part]
    return "\n- ".join(" ".join(item.split()) for item in items)


def _texts(frame: pd.DataFrame, column: Column) -> list[str]:
    values = frame[column.source]
    if column.text is None:
        return [str(v) for v in values]
    texts = []
    for value, (_, row) in zip(values, frame.iterrows(), strict=True):
        numbers = [value, row[column.spread]] if column.spread else [value]
        text = column.text(*(float("nan") if pd.isna(one) else float(one) for one in numbers))
        if column.interval and pd.notna(row[column.interval[0]]):
            text += f" {column.bounds(*row[list(column.interval)])}"
        texts.append(text)
    return texts
