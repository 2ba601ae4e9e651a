"""Progress of long work: a bar on a terminal, plain lines elsewhere."""

import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

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
from rich.table import Column
from rich.text import Text

from cli.output import echo
from pipeline.figures.labels import number
from pipeline.progress import Progress as JobProgress
from pipeline.text import public, visible

LINE_SECONDS = 5.0  # how often work that is not on a terminal says where it is


class _RateColumn(ProgressColumn):
    """How many units are done a second."""

    def render(self, task: Task) -> Text:
        return Text(f"{number(task.speed)}/s" if task.speed else "")


class _NoteColumn(ProgressColumn):
    """The last note, cut where there is no room for it."""

    def render(self, task: Task) -> Text:
        return Text(task.fields["note"], no_wrap=True, overflow="ellipsis")


class DisplayedProgress(JobProgress):
    """Progress of some work on stderr, once its total is known."""

    def __init__(self, what: str, stack: ExitStack) -> None:
        self.count = self.failed = 0  # units that are done, and how many of them failed
        self._what, self._stack = visible(what), stack
        self._bar: Progress | None = None

    def expect(self, total: int) -> None:
        """Begin to show progress towards so many units; none show nothing."""
        self._stack.close()
        console = Console(stderr=True)
        self._bar, self._told = _bar(console) if total else None, 0.0
        if self._bar:
            self._task = self._bar.add_task(self._what, total=total, note="")
            if console.is_terminal:
                self._stack.enter_context(self._bar)

    def done(self, units: int = 1, note: str = "", *, failed: int | None = None) -> None:
        """Show what is done, with the note and the share that failed."""
        if units == 0:
            return
        self.count += units
        if failed is not None:
            self.failed += failed
            note = f"{self.failed / self.count:.1%} failed"
        if self._bar:
            self._bar.update(self._task, advance=units, note=visible(note))
            self._print_line(self._bar)

    def end(self, note: str) -> None:
        """Show that it is over."""
        if self._bar and not (task := self._bar.tasks[self._task]).finished:
            self._bar.update(self._task, total=task.completed, note=visible(note))
            self._print_line(self._bar)

    def say(self, sentence: str) -> None:
        """Tell a person, beside the output."""
        echo(f"prolearn: {public(sentence)}", err=True)

    def _print_line(self, bar: Progress) -> None:
        """Where there is no bar, print a line of progress now and then and at the end."""
        task = bar.tasks[self._task]
        done, total, seconds = task.completed, task.total or 0.0, task.elapsed or 0.0
        if bar.console.is_terminal or (seconds - self._told < LINE_SECONDS and done < total):
            return
        self._told = seconds
        parts = [f"{self._what}: {done:.0f}/{total:.0f} after {seconds:.0f} s"]
        if 0 < done < total and seconds > 0:
            left = (total - done) * seconds / done
            parts += [f"{number(done / seconds)}/s", f"{left:.0f} s left"]
        note = task.fields["note"]
        bar.console.print(Text(", ".join(parts + [note] * bool(note))), soft_wrap=True)


@contextmanager
def progress(what: str) -> Iterator[DisplayedProgress]:
    """Show how far some work is, such as "solving"."""
    with ExitStack() as stack:
        yield DisplayedProgress(what, stack)


def _bar(console: Console) -> Progress:
    """The bar; where the terminal is narrow, it and the note shrink and no number does."""
    whole = Column(no_wrap=True)
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=24),
        MofNCompleteColumn(table_column=whole),
        _RateColumn(table_column=whole),
        TimeElapsedColumn(table_column=whole),
        TextColumn("left"),
        TimeRemainingColumn(table_column=whole),
        _NoteColumn(),
        console=console,
        # Output to a file or a pipe must go there and not to the bar.
        redirect_stdout=bool(sys.stdout and sys.stdout.isatty()),
    )
