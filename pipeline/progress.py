"""Progress of long work, for whoever watches it."""


class Progress:
    """Told how far some work is; this one makes nothing of it."""

    def expect(self, total: int) -> None:
        """Told how many units there are, before the first; again where other work begins."""

    def done(self, units: int = 1, note: str = "", *, failed: int | None = None) -> None:
        """Told how many units are done just now, a word on them, and how many of them failed."""

    def end(self, note: str) -> None:
        """Told why no more units come, where they were fewer than expected."""

    def say(self, sentence: str) -> None:
        """Told of anything that a person should know."""


SILENT = Progress()
