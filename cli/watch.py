"""A stage's progress on the terminal."""

from collections.abc import Iterator
from contextlib import contextmanager

from cli.progress import Stage, say, stage
from pipeline.dataset.watch import Watch


class StageWatch(Watch):
    """Shows how far a stage is and counts what it did.

    Attributes:
        rows: rows that are done.
        failed: how many of them failed.
    """

    def __init__(self, shown: Stage, *, can_fail: bool) -> None:
        self.rows = self.failed = 0
        self._shown, self._can_fail = shown, can_fail

    def expect(self, rows: int) -> None:
        """Start to show progress where there is something to do."""
        self._shown.expect(rows)

    def done(self, rows: int, failed: int = 0) -> None:
        """Show what is done, and the share that failed."""
        self.rows += rows
        self.failed += failed
        if rows:
            note = f"{self.failed / self.rows:.1%} failed" if self._can_fail else ""
            self._shown.advance(rows, note)

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
    with stage(what) as shown:
        yield StageWatch(shown, can_fail=can_fail)
