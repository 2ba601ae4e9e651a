"""How far beyond n = 30 networks carry, in sentences and as answers."""

from dataclasses import dataclass
from itertools import takewhile

import pandas as pd

from pipeline.experiments.answer import FREE, Answer, Measured, measured
from pipeline.experiments.networks import YES, Group, groups, of, spokesman, verdict
from pipeline.experiments.paper import LARGEST_SIZE, NETWORK_SIZE


@dataclass(frozen=True)
class Carried:
    """What a network does at one size after another.

    Attributes:
        group: the networks that it speaks for.
        at: what it does, by size.
    """

    group: Group
    at: dict[int, Measured]

    @property
    def sizes(self) -> list[int]:
        """Up to which it carries: those before the first at which it is not safe and cheap."""
        return [n for n, _ in takewhile(lambda row: row[1] == YES, self._verdicts.items())]

    @property
    def _verdicts(self) -> dict[int, str]:
        return {n: verdict([found]) for n, found in self.at.items()}

    @property
    def reach(self) -> str:
        """The same in words that follow the network's name."""
        kept = self.sizes
        if len(kept) == len(self.at):
            return f"carries to n = {kept[-1]}, the largest tried"
        following = list(self.at)[len(kept)]
        if self._verdicts[following].startswith("Open"):
            too_few = f"too few trials at n = {following}"
            return f"carries to n = {kept[-1]}; {too_few}" if kept else f"stays open: {too_few}"
        return f"carries to n = {kept[-1]} and no further" if kept else f"fails at n = {following}"

    @property
    def name(self) -> str:
        """What it is called."""
        return next(iter(self.at.values())).name

    @property
    def numbers(self) -> str:
        """What it does at each size."""
        return "; ".join(f"at n = {n} {found.text}" for n, found in self.at.items())

    @property
    def sentence(self) -> str:
        """How far it carries, and the numbers that say so."""
        return f"{self.name}, trained at n = {NETWORK_SIZE}, {self.reach}: {self.numbers}."


def carried(shown: pd.DataFrame, training: pd.DataFrame) -> list[Carried]:
    """What each group of networks does beyond n = 30, where one speaks for it.

    Args:
        shown: from ``shown_beyond``.
        training: a row for each trained model.
    """
    found = []
    for group in groups(shown["planner"]):
        rows = group.of(shown)
        name, _ = spokesman(rows, training)
        if name is not None:
            at = {int(str(n)): measured(part) for n, part in of(rows, name).groupby("n")}
            found.append(Carried(group, at))
    return found


def carry_answers(shown: pd.DataFrame, training: pd.DataFrame) -> list[Answer]:
    """A row for each group of networks, where swarms beyond n = 30 were evaluated.

    Args:
        shown: from ``shown_beyond``.
        training: a row for each trained model.
    """
    free = shown[shown["planner"] == FREE]
    largest = free[free["n"] == free["n"].max()]
    beside = "" if free.empty else f"Own LP at n = {largest['n'].iloc[0]}: {measured(largest).text}"
    asked = f"beyond n = {LARGEST_SIZE} does"
    return [
        Answer(
            one.group.asked(
                f"How far {asked} a network of the paper's carry?", f"How far {asked} {{}} carry?"
            ),
            one.reach[0].upper() + one.reach[1:],
            f"{one.name}: {one.numbers}",
            beside,
        )
        for one in carried(shown, training)
    ]
