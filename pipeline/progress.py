"""Reports of the progress of long work."""


class Progress:
    """Receives the progress of some work; this one ignores it."""

    def expect(self, total: int) -> None:
        """The number of units, before the first; again where other work begins."""

    def done(self, units: int = 1, note: str = "", *, failed: int | None = None) -> None:
        """Units that are done just now, a note on them, and how many of them failed."""

    def end(self, note: str) -> None:
        """The reason why no more units come, where they were fewer than expected."""

    def say(self, sentence: str) -> None:
        """Anything that a person should know."""


SILENT = Progress()
