"""An answer: a verdict, the numbers that it rests on, and what costs nothing beside them."""

from dataclasses import dataclass

import pandas as pd

from pipeline.exhibits.numbers import number, percents, ratio, share
from pipeline.exhibits.planners import name_of
from pipeline.experiments.averages import as_share, fuel_ratio
from pipeline.experiments.compare import Interval, mean_interval, share_interval

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
        trials: scenarios.
        trainings: averaged over, 1 where nothing is trained.
        safe: share of safe trials.
        safe_interval: Wilson's interval of it.
        fuel: mean of fuel over its bound.
        fuel_interval: of that mean.
    """

    name: str
    trials: int
    trainings: int
    safe: float
    safe_interval: Interval
    fuel: float
    fuel_interval: Interval

    @property
    def text(self) -> str:
        """Both numbers with their intervals."""
        return (
            f"safe in {share_text(self.safe, self.safe_interval)} at "
            f"{ratio(self.fuel)} {interval_text(self.fuel_interval)} of the bound"
        )


def with_ratio(trials: pd.DataFrame) -> pd.DataFrame:
    """Trials with the column fuel_ratio, fuel over its bound, and safe as 1 or 0."""
    return trials.assign(fuel_ratio=fuel_ratio(trials), safe=as_share(trials["safe"]))


def measured(rows: pd.DataFrame) -> Measured:
    """The numbers of one planner's trials, of one or several trainings."""
    first = rows.iloc[0]
    per = rows.groupby("trial")[["safe", "fuel_ratio"]].mean()
    safe = float(per["safe"].mean())
    return Measured(
        name=called(str(first["planner"]), str(first["recipe"] or "")),
        trials=len(per),
        trainings=int(rows["training_seed"].nunique()),
        safe=safe,
        safe_interval=share_interval(safe, len(per)),
        fuel=float(per["fuel_ratio"].mean()),
        fuel_interval=mean_interval(per["fuel_ratio"].dropna().to_numpy(dtype=float)),
    )


def called(planner: str, recipe: str) -> str:
    """A planner with its recipe."""
    return f"{name_of(planner)} {recipe}".strip()


def share_text(value: float, interval: Interval) -> str:
    """A share with its interval, in percent."""
    return f"{share(value)} {percents(*interval)}"


def interval_text(interval: Interval) -> str:
    """An interval of ratios."""
    return f"[{ratio(interval[0])}, {ratio(interval[1])}]"


def span(values: "pd.Series[float] | list[float]") -> str:
    """The least and the greatest of some numbers."""
    low, high = min(values), max(values)
    return number(low) if low == high else f"{number(low)} to {number(high)}"
