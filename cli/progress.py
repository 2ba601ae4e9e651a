"""Progress of long work: a bar on a terminal, plain lines elsewhere."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from time import monotonic
from typing import TypeVar

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

from cli.output import echo
from pipeline.progress import Progress as JobProgress
from pipeline.text import visible
from pipeline.urls import public

LINE_SECONDS = 5.0
"""How often work that is not on a terminal says where it is."""


class RateColumn(ProgressColumn):
    """How many units are done a second."""

    def render(self, task: Task) -> Text:
        """The recent rate."""
        return Text(f"{task.speed:.3g}/s" if task.speed else "")


class NoteColumn(ProgressColumn):
    """The note, cut where there is no room for it."""

    def render(self, task: Task) -> Text:
        """The last note."""
        return Text(task.fields["note"], no_wrap=True, overflow="ellipsis")


class Shown(JobProgress):
    """Shows how far some work is once it says how much there is of it.

    Attributes:
        count: units that are done.
        failed: how many of them failed.
    """

    def __init__(self, what: str, stack: ExitStack) -> None:
        self.count = self.failed = 0
        self._what, self._stack = visible(what), stack
        self._display: _Bar | _Lines | None = None

    def expect(self, total: int) -> None:
        """Begin to show progress towards so many units; none show nothing."""
        self._stack.close()
        self._display, console = None, Console(stderr=True)
        if total and console.is_terminal:
            bar = self._stack.enter_context(_columns(console))
            self._display = _Bar(bar, bar.add_task(self._what, total=total, note=""))
        elif total:
            self._display = _Lines(console, self._what, total)

    def done(self, units: int = 1, note: str = "", *, failed: int | None = None) -> None:
        """Show what is done, with the note and the share that failed."""
        if units == 0:
            return
        self.count += units
        if failed is not None:
            self.failed += failed
            note = f"{self.failed / self.count:.1%} failed"
        if self._display:
            self._display.advance(units, visible(note))

    def end(self, note: str) -> None:
        """Show that it is over."""
        if self._display:
            self._display.end(visible(note))

    def say(self, sentence: str) -> None:
        """Tell a person, beside the output."""
        echo(f"prolearn: {public(sentence)}", err=True)


@contextmanager
def progress(what: str) -> Iterator[Shown]:
    """Show how far some work is, such as "solving"."""
    with ExitStack() as stack:
        yield Shown(what, stack)


Item = TypeVar("Item")


def each(what: str, items: Sequence[Item]) -> Iterator[Item]:
    """The items one by one, showing how many of them are done where there are several."""
    with progress(what) as shown:
        shown.expect(len(items) if len(items) > 1 else 0)
        for item in items:
            yield item
            shown.done()


def _columns(console: Console) -> Progress:
    """The bar; where the terminal is narrow, it and the note shrink and no number does."""
    whole = Column(no_wrap=True)
    return Progress(
        TextColumn("{task.description}", markup=False),
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

    def advance(self, done: int, note: str) -> None:
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

    def advance(self, done: int, note: str) -> None:
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
        self._console.print(Text(said), soft_wrap=True)
