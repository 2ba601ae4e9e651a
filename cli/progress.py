"""Progress of long work: a bar on a terminal, plain lines elsewhere."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from time import monotonic
from typing import Protocol, TypeVar

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column
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


class NoteColumn(ProgressColumn):
    """The note, cut where there is no room for it."""

    def render(self, task: Task) -> Text:
        """The last note."""
        return Text(task.fields["note"], no_wrap=True, overflow="ellipsis")


class Shown(Protocol):
    """Progress on the screen."""

    def advance(self, done: int, note: str = "") -> None:
        """Count units just done, with a note to show."""

    def end(self, note: str) -> None:
        """Say why no more units come, where there were fewer than thought."""


@contextmanager
def progress(what: str, total: int) -> Iterator[Shown]:
    """Show how far some work is.

    Args:
        what: the work, such as "solving".
        total: units of it.
    """
    console = Console(stderr=True)
    if console.is_terminal:
        with _columns(console) as bar:
            yield _Bar(bar, bar.add_task(what, total=total, note=""))
    else:
        yield _Lines(console, what, total)


class Stage:
    """Work that says how much there is of it once it knows; where there is none, nothing shows."""

    def __init__(self, what: str, stack: ExitStack) -> None:
        self._what, self._stack = what, stack
        self._shown: Shown | None = None

    def expect(self, total: int) -> None:
        """Begin to show progress towards so many units."""
        self._stack.close()
        self._shown = None
        if total > 0:
            self._shown = self._stack.enter_context(progress(self._what, total))

    def advance(self, done: int, note: str = "") -> None:
        """Count units just done, with a note to show."""
        if self._shown:
            self._shown.advance(done, note)

    def end(self, note: str) -> None:
        """Say why no more units come, where there were fewer than thought."""
        if self._shown:
            self._shown.end(note)


@contextmanager
def stage(what: str) -> Iterator[Stage]:
    """Show how far some work is that finds out itself how much there is to do.

    Args:
        what: the work, such as "evaluating".
    """
    with ExitStack() as stack:
        yield Stage(what, stack)


Item = TypeVar("Item")


def each(what: str, items: Sequence[Item]) -> Iterator[Item]:
    """The items one by one, showing how many of them are done where there are several."""
    with stage(what) as shown:
        shown.expect(len(items) if len(items) > 1 else 0)
        for item in items:
            yield item
            shown.advance(1)


def _columns(console: Console) -> Progress:
    """The bar; where the terminal is narrow, it and the note shrink and no number does."""
    whole = Column(no_wrap=True)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(table_column=whole),
        RateColumn(table_column=whole),
        TimeElapsedColumn(table_column=whole),
        TextColumn("left"),
        TimeRemainingColumn(table_column=whole),
        NoteColumn(),
        console=console,
        redirect_stdout=sys.stdout.isatty(),  # what goes to a file or a pipe must go there
    )


class _Bar:
    """A bar on a terminal."""

    def __init__(self, bar: Progress, task: TaskID) -> None:
        self._bar, self._task = bar, task

    def advance(self, done: int, note: str = "") -> None:
        self._bar.update(self._task, advance=done, note=note)

    def end(self, note: str) -> None:
        task = self._bar.tasks[self._task]
        if not task.finished:
            self._bar.update(self._task, total=task.completed, note=note)


class _Lines:
    """Plain lines, now and then and at the end."""

    def __init__(self, console: Console, what: str, total: int) -> None:
        self._console, self._what, self._total = console, what, total
        self._started = self._last = monotonic()
        self._count = 0

    def advance(self, done: int, note: str = "") -> None:
        self._count += done
        now = monotonic()
        if now - self._last >= LINE_SECONDS or self._count >= self._total:
            self._last = now
            self._print(now - self._started, note)

    def end(self, note: str) -> None:
        if self._count < self._total:
            self._total = self._count
            self.advance(0, note)

    def _print(self, seconds: float, note: str) -> None:
        parts = [f"{self._what}: {self._count}/{self._total} after {seconds:.0f} s"]
        if 0 < self._count < self._total and seconds > 0:
            rate = self._count / seconds
            parts += [f"{rate:.3g}/s", f"{(self._total - self._count) / rate:.0f} s left"]
        said = ", ".join(parts + [note] * bool(note))
        self._console.print(said, highlight=False, soft_wrap=True, markup=False)
