"""What commands print on standard output: tables for people, JSON for programs."""

import sys
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON document, and all else on stderr.")
]

WIDE = 1000
"""Columns that a table may take where no terminal cuts it."""

LEAST = 8
"""Characters of its first column that a table keeps on the narrowest terminal."""


def print_table(
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    texts: int = 1,
    marked: Collection[int] = (),
) -> None:
    """Print a table, plain and in full width where it does not go to a terminal.

    Args:
        headings: of the columns, on one line or two.
        rows: their cells; on a terminal the first gives way at its beginning, for the rest to fit.
        texts: how many columns are text and aligned left; the others are numbers.
        marked: rows shown in red.
    """
    console = Console()
    width = console.width if console.is_terminal else WIDE
    columns = zip(headings, *rows, strict=True)
    wide = [max(len(line) for cell in column for line in cell.split("\n")) for column in columns]
    room = max(LEAST, width - sum(wide[1:]) - len(wide))
    table = Table(box=None, header_style="bold", padding=(0, 1, 0, 0), pad_edge=False)
    for k, heading in enumerate(headings):
        table.add_column(heading, justify="left" if k < texts else "right", no_wrap=True)
    for k, (first, *cells) in enumerate(rows):
        shown = first if len(first) <= room else f"…{first[1 - room :]}"
        table.add_row(*map(Text, (shown, *cells)), style="red" if k in marked else None)
    Console(width=width).print(table)


@contextmanager
def beside(as_json: bool) -> Iterator[None]:
    """In the block, whatever prints does so on stderr where stdout is for a document."""
    if not as_json:
        yield
        return
    with redirect_stdout(sys.stderr):
        yield


def print_json(document: Any) -> None:
    """Print strict JSON: what is not a finite number is null, times are as in ISO 8601.

    Args:
        document: dataclasses, mappings, sequences, paths, times, and numbers of numpy's, too.
    """
    from pydantic_core import to_json

    text = to_json(document, indent=2, inf_nan_mode="null", fallback=lambda value: value.tolist())
    typer.echo(text.decode())
