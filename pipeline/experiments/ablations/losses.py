"""What the refiner loses with each thing that it lacks."""

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from pipeline.exhibits.intervals import Interval
from pipeline.experiments.ablations.summary import difference
from pipeline.experiments.compare import compare
from pipeline.networks.refiner.ablations import ABLATIONS, SHORT


@dataclass(frozen=True)
class Loss:
    """What a refiner that lacks one thing does worse than ``short``, on the same trials.

    Attributes:
        recipe: which.
        score: difference in score, as a share of the bound; positive where it is worse.
        interval: of that mean over the trials.
        spread: the larger standard deviation between trainings of either; 0 where there is one.
    """

    recipe: str
    score: float
    interval: Interval
    spread: float

    @property
    def worse(self) -> bool:
        """Whether it is worse beyond chance, and beyond the spread between trainings."""
        return self.interval[0] > 0 and self.score > self.spread

    @property
    def better(self) -> bool:
        """Whether it is better, likewise."""
        return self.interval[1] < 0 and -self.score > self.spread

    @property
    def cost(self) -> str:
        """The difference with its interval."""
        return difference(self.score, self.interval)


def losses(rows: pd.DataFrame, recipes: Sequence[str] = ABLATIONS) -> list[Loss]:
    """What another way to be trained costs, the dearest first; none where ``short`` was not tried.

    Args:
        rows: as for ``gain``.
        recipes: those ways; each lacks one thing by default.
    """
    short = rows[rows["recipe"] == SHORT]
    found = []
    for recipe in recipes if len(short) else ():
        mine = rows[rows["recipe"] == recipe]
        if len(mine):
            held = compare(mine, short, "score")
            spread = max(_spread(mine), _spread(short))
            found.append(Loss(recipe, held.fuel, held.fuel_interval, spread))
    return sorted(found, key=lambda loss: -loss.score)


def _spread(rows: pd.DataFrame) -> float:
    """Standard deviation of the score between trainings."""
    each = rows.groupby("training_seed")["score"].mean()
    return float(each.std()) if len(each) > 1 else 0.0
