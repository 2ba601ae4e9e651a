"""The scenarios on which ablations are tried: a family and a swarm size."""

from dataclasses import dataclass

import pandas as pd

RINGS = "rings"
"""The paper's family."""


@dataclass(frozen=True, order=True)
class Ground:
    """Scenarios of one family and size.

    Attributes:
        other: the family, where it is not that of the paper; else nothing.
        n: swarm size.
    """

    other: str
    n: int

    @property
    def label(self) -> str:
        """In headings and numbers."""
        return f"{self.other}, n = {self.n}" if self.other else f"n = {self.n}"

    @property
    def where(self) -> str:
        """At the beginning of a sentence."""
        return f"In {self.other} swarms of {self.n}" if self.other else f"At n = {self.n}"

    @property
    def slug(self) -> str:
        """In names of files."""
        return f"{self.other}-n{self.n}" if self.other else f"n{self.n}"


def grounds(rows: pd.DataFrame) -> dict[Ground, pd.DataFrame]:
    """The rows on each, those of the paper's family first.

    Args:
        rows: with columns family and n.
    """
    found = {}
    for (family, n), part in rows.groupby(["family", "n"]):
        found[Ground("" if family == RINGS else str(family), int(str(n)))] = part
    return dict(sorted(found.items()))
