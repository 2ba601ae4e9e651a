"""A stage's progress on the terminal."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from cli.progress import Advance, progress, say
from pipeline.dataset.watch import Watch


class StageWatch(Watch):
    """Shows how far a stage is and counts what it did.

    Attributes:
        rows: rows that are done.
        failed: how many of them failed.
    """

    def __init__(self, what: str, stack: ExitStack, *, can_fail: bool) -> None:
        self.rows = self.failed = 0
        self._what, self._stack, self._can_fail = what, stack, can_fail
        self._advance: Advance | None = None

    def expect(self, rows: int) -> None:
        """Start to show progress where there is something to do."""
        self._stack.close()
        self._advance = None
        if rows:
            self._advance = self._stack.enter_context(progress(self._what, rows))

    def done(self, rows: int, failed: int = 0) -> None:
        """Show what is done, and the share that failed."""
        self.rows += rows
        self.failed += failed
        if self._advance and rows:
            note = f"{self.failed / self.rows:.1%} failed" if self._can_fail else ""
            self._advance(rows, note)

    def say(self, sentence: str) -> None:
        """Say it."""
        say(sentence)


@contextmanager
def watching(what: str, *, can_fail: bool = False) -> Iterator[StageWatch]:
    """Watch a stage.

    Args:
        what: what it does, such as "solving".
        can_fail: whether rows may fail without the stage failing.
    """
    with ExitStack() as stack:
        yield StageWatch(what, stack, can_fail=can_fail)
