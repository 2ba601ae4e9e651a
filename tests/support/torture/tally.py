"""What came of all tries, as a table."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum

from tabulate import tabulate


class Outcome(StrEnum):
    """What came of one try, the best first."""

    NOTHING = "no effect"
    NOTICED = "noticed"
    MENDED = "mended"
    LOST = "lost"
    SILENT = "in silence"
    TRACEBACK = "traceback"
    ORPHANS = "processes left"


BAD = (Outcome.LOST, Outcome.SILENT, Outcome.TRACEBACK, Outcome.ORPHANS)


@dataclass
class Tally:
    """Outcomes by the kind of damage and what was damaged."""

    counts: dict[tuple[str, str], Counter[Outcome]] = field(default_factory=dict)
    stories: list[str] = field(default_factory=list)

    def add(self, damage: str, what: str, outcome: Outcome, story: str, tries: int = 1) -> None:
        """Count tries with one outcome; what ended badly is kept as a story."""
        self.counts.setdefault((damage, what), Counter())[outcome] += tries
        if outcome in BAD:
            self.stories.append(f"{damage}, {what}: {outcome}: {story}")

    @property
    def bad(self) -> int:
        """How many ended badly."""
        return sum(count[outcome] for count in self.counts.values() for outcome in BAD)

    def tries(self, damage: str) -> int:
        """How many there were of a kind."""
        return sum(count.total() for (kind, _), count in self.counts.items() if kind == damage)

    def markdown(self) -> str:
        """A row for each kind of damage and what was damaged, and for each kind in all."""
        head = ("damage", "to", "tries", *map(str, Outcome))
        return tabulate(list(self._rows()), head, tablefmt="github")

    def _rows(self) -> Iterator[tuple[str | int, ...]]:
        for kind in dict.fromkeys(kind for kind, _ in self.counts):
            parts = {what: count for (one, what), count in self.counts.items() if one == kind}
            if len(parts) > 1:
                parts = {**parts, "all": sum(parts.values(), Counter())}
            for what, count in parts.items():
                yield kind, what, count.total(), *(count[outcome] for outcome in Outcome)
