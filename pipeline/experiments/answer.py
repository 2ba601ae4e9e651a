"""An answer: a verdict, the numbers that it rests on, and what costs nothing beside them."""

from dataclasses import dataclass

import pandas as pd

from pipeline.exhibits.intervals import Interval, wilson
from pipeline.exhibits.numbers import number, percents, ratio, share
from pipeline.exhibits.planners import name_of
from pipeline.experiments.compare import mean_interval

FREE = "own LP"
"""The best planner that costs nothing: each craft's own optimum, at the bound on fuel."""

SAFE = 0.95
"""Share of trials, by the whole of its interval, from which a planner is called safe."""

CHEAP = 1.1
"""Fuel over its bound, by the whole of its interval, up to which a planner is called cheap."""


@dataclass(frozen=True)
class Answer:
    """A row of the table of questions.

    Attributes:
        question: what is asked.
        verdict: the short answer.
        numbers: the two or three that it rests on, with their uncertainty.
        baseline: the same of the best baseline that costs nothing.
    """

    question: str
    verdict: str
    numbers: str
    baseline: str = ""


@dataclass(frozen=True)
class Measured:
    """What one planner does at one swarm size.

    Attributes:
        name: what it is called.
        trainings: averaged over, 1 where nothing is trained.
        safe: share of safe trials.
        safe_interval: Wilson's interval of it.
        fuel: mean of fuel over its bound.
        fuel_interval: of that mean.
    """

    name: str
    trainings: int
    safe: float
    safe_interval: Interval
    fuel: float
    fuel_interval: Interval

    @property
    def text(self) -> str:
        """Both numbers with their intervals."""
        low, high = map(ratio, self.fuel_interval)
        return (
            f"safe in {share(self.safe)} {percents(*self.safe_interval)} at {ratio(self.fuel)} "
            f"[{low}, {high}] of the bound"
        )


def measured(rows: pd.DataFrame) -> Measured:
    """The numbers of one planner's trials from ``prepared``, of one or several trainings."""
    first = rows.iloc[0]
    per = rows.groupby("trial")[["safe", "fuel_ratio"]].mean()
    safe = float(per["safe"].mean())
    return Measured(
        name=f"{name_of(first['planner'])} {first['recipe']}".strip(),
        trainings=int(rows["training_seed"].nunique()),
        safe=safe,
        safe_interval=wilson(safe, len(per)),
        fuel=float(per["fuel_ratio"].mean()),
        fuel_interval=mean_interval(per["fuel_ratio"].dropna().to_numpy(dtype=float)),
    )


def span(values: "pd.Series[float] | list[float]") -> str:
    """The least and the greatest of some numbers."""
    low, high = min(values), max(values)
    return number(low) if low == high else f"{number(low)} to {number(high)}"
