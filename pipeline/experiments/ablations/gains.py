"""A refiner beside the rule alone: what learning buys."""

from dataclasses import dataclass

import pandas as pd

from pipeline.experiments.ablations.summary import difference
from pipeline.experiments.compare import CHANCE, Compared, compare
from pipeline.networks.refiner.ablations import RULE, SHORT, TUNED

DIVIDED = {("safer", "dearer"), ("less safe", "cheaper")}
"""Words of which one is for learning and one against it."""

NOTHING = "nothing beyond chance"


@dataclass(frozen=True, eq=False)
class Gain:
    """A refiner beside the rule alone, on the same trials.

    Attributes:
        recipe: how it was trained.
        held: the refiner compared with the rule.
        mine: its trials.
        rule: those of the rule.
    """

    recipe: str
    held: Compared
    mine: pd.DataFrame
    rule: pd.DataFrame

    @property
    def verdict(self) -> str:
        """What is different beyond chance."""
        held, (low, high) = self.held, self.held.fuel_interval
        told = {1: "safer", 0: "", -1: "less safe"}
        safe = told[0 if held.safe_by_chance > CHANCE else 1 if held.safe > 0 else -1]
        fuel = "cheaper" if high < 0 else "dearer" if low > 0 else ""
        if not (safe or fuel):
            return NOTHING
        joined = " but " if (safe, fuel) in DIVIDED else " and "
        return joined.join(filter(None, (safe, fuel)))

    @property
    def text(self) -> str:
        """The differences with their intervals."""
        held = self.held
        low, high = held.safe_interval
        return (
            f"{self.recipe}'s fuel {difference(held.fuel, held.fuel_interval)} of the bound, "
            f"{100 * held.safe:+.1f} % safe [{100 * low:+.1f}, {100 * high:+.1f}]"
        )


def gain(rows: pd.DataFrame) -> Gain | None:
    """The tuned refiner beside the rule, or the short one where there is no other.

    Args:
        rows: from ``scored``, on one ground and of the networks' own rounds.
    """
    rule = rows[rows["planner"] == RULE]
    for recipe in (TUNED, SHORT):
        mine = rows[rows["recipe"] == recipe]
        if len(mine) and len(rule):
            return Gain(recipe, compare(mine, rule), mine, rule)
    return None
