"""What the stages tell whoever watches them."""


class Watch:
    """Told how far a stage is; this one makes nothing of it."""

    def expect(self, rows: int) -> None:
        """Told once, before the first row, how many are to be done."""

    def done(self, rows: int, failed: int = 0) -> None:
        """Told after each shard how many rows it has and how many of them failed."""

    def say(self, sentence: str) -> None:
        """Told of anything that a person should know."""


SILENT = Watch()
