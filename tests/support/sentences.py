"""A progress report that keeps its sentences."""

from pipeline.progress import Progress


class Sentences(Progress):
    """Progress report that keeps what a person would be told."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def say(self, sentence: str) -> None:
        self.said.append(sentence)
