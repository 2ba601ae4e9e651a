"""What commands print: lines and tables for people, JSON for programs."""

import json
import sys
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout
from io import TextIOWrapper
from itertools import accumulate
from textwrap import fill
from typing import Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from pipeline.errors import InputError
from pipeline.files import STDIO, write_text
from pipeline.text import visible

WIDE = 1000  # columns that a table may take where no terminal cuts it
LEAST = 8  # characters of its first column that a table keeps on the narrowest terminal


def escape_unencodable() -> None:
    """Show characters that stdout's encoding lacks, such as Δ in Latin-1, as escapes."""
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def echo(*lines: object, err: bool = False) -> None:
    """Print lines on stdout or stderr; control and invisible characters are shown as escapes."""
    for line in lines:
        typer.echo(visible(str(line)), err=err)


def wide_console() -> Console:
    """Rich console of standard output: as wide as the terminal, or too wide to wrap elsewhere."""
    console = Console()
    return console if console.is_terminal else Console(width=WIDE)


def note(*lines: object) -> None:
    """Print lines for people: on a terminal wrapped at its width, elsewhere each as one line."""
    console = Console()
    for line in lines:
        if console.is_terminal:
            console.print(plain_text(line))
        else:
            echo(line)


def plain_text(text: object, style: str = "") -> Text:
    """A text for rich without markup, with invisible characters as escapes."""
    return Text(visible(str(text)), style)


def print_result(as_json: bool, document: Any, *lines: object) -> None:
    """Print a document for programs, or lines for people."""
    print_json(document) if as_json else echo(*lines)


def print_table(
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    texts: Collection[int] = (0,),
    marked: Collection[int] = (),
    folded: bool = False,
) -> None:
    """Print a table, plain and in full width where it does not go to a terminal.

    On a terminal the first column is cut at its beginning, or ``folded`` at spaces, where the rest
    would not fit; columns that still do not fit follow in a table below. Columns in ``texts`` are
    aligned left, the others right; rows in ``marked`` are red.
    """
    rows = [[visible(cell) for cell in row] for row in rows]
    console = wide_console()
    columns = zip(headings, *rows, strict=True)
    wide = [max(len(line) for cell in column for line in cell.split("\n")) for column in columns]
    taken = accumulate(one + 1 for one in (min(LEAST, wide[0]), *wide[1:]))
    fit = max(2, sum(one <= console.width for one in taken))
    if fit < len(wide):
        for which in (range(fit), [0, *range(fit, len(wide))]):
            part = [[row[k] for k in which] for row in (headings, *rows)]
            left = [k for k, column in enumerate(which) if column in texts]
            print_table(part[0], part[1:], texts=left, marked=marked, folded=folded)
        return
    room = max(LEAST, console.width - sum(wide[1:]) - len(wide))
    table = Table(box=None, header_style="bold", padding=(0, 1, 0, 0), pad_edge=False)
    for k, heading in enumerate(headings):
        table.add_column(heading, justify="left" if k in texts else "right", no_wrap=True)
    for k, (first, *cells) in enumerate(rows):
        cut = fill(first, room, subsequent_indent="    ") if folded else f"…{first[1 - room :]}"
        shown = first if len(first) <= room else cut
        table.add_row(*map(Text, (shown, *cells)), style="red" if k in marked else None)
    console.print(table)


@contextmanager
def stdout_for_document(as_json: bool) -> Iterator[None]:
    """In the block, all that is printed goes to stderr where stdout is for a document."""
    with redirect_stdout(sys.stderr) if as_json else nullcontext():
        yield


def stdout_free(out: object, as_json: bool) -> bool:
    """Whether stdout is free for messages; InputError where two documents would go there."""
    if out == STDIO and as_json:
        raise InputError(
            "--json is given and --out is -; expected one of them, since stdout takes one document."
        )
    return out != STDIO


def print_json(document: Any) -> None:
    """Print strict JSON: infinities and NaN are null, times are in ISO 8601.

    The document may also hold dataclasses, paths, times and numpy's numbers. Invisible characters
    of its texts become JSON's escapes.
    """
    from pydantic_core import to_jsonable_python

    plain = to_jsonable_python(document, inf_nan_mode="null", fallback=lambda value: value.tolist())
    text = json.dumps(plain, indent=2, ensure_ascii=False, allow_nan=False)
    lines = (visible(line, lambda c: json.dumps(c)[1:-1]) for line in text.split("\n"))
    write_text(STDIO, "\n".join(lines) + "\n")
