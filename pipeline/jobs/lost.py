"""What the loss of workers is told by."""


class WorkersLostError(Exception):
    """Workers, or the way to them, are lost with all calls under way.

    Attributes:
        again: what to say where it happens again and again, with what to do then.
    """

    def __init__(self, once: str, again: str) -> None:
        super().__init__(once)
        self.again = again
