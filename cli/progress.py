"""Progress of long work: a bar on a terminal, plain lines elsewhere."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from pipeline.urls import public

LINE_SECONDS = 5.0
"""How often work that is not on a terminal says where it is."""


class RateColumn(ProgressColumn):
    """How many units are done a second."""

    def render(self, task: Task) -> Text:
        """The rate of late."""
        return Text(f"{task.speed:.3g}/s" if task.speed else "")


def say(sentence: str) -> None:
    """Tell a person what they should know, beside the output."""
    typer.echo(f"prolearn: {public(sentence)}", err=True)


Advance = Callable[[int, str], None]
"""Called with the units just done and a note to show."""


@contextmanager
def progress(what: str, total: int) -> Iterator[Advance]:
    """Show how far some work is.

    Args:
        what: the work, such as "solving".
        total: units of it.
    """
    console = Console(stderr=True)
    with_bar = _bar if console.is_terminal else _lines
    with with_bar(console, what, total) as advance:
        yield advance


@contextmanager
def _bar(console: Console, what: str, total: int) -> Iterator[Advance]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        RateColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(what, total=total, note="")
        yield lambda done, note: bar.update(task, advance=done, note=note)


@contextmanager
def _lines(console: Console, what: str, total: int) -> Iterator[Advance]:
    started = last = monotonic()
    count = 0

    def advance(done: int, note: str) -> None:
        nonlocal count, last
        count += done
        now = monotonic()
        if now - last >= LINE_SECONDS or count >= total:
            last = now
            parts = [f"{what}: {count}/{total} after {now - started:.0f} s"]
            if 0 < count < total and now > started:
                rate = count / (now - started)
                parts += [f"{rate:.3g}/s", f"{(total - count) / rate:.0f} s left"]
            console.print(", ".join(parts + [note] * bool(note)), highlight=False, soft_wrap=True)

    yield advance
