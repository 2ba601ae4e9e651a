"""How our rows compare with the paper's Table 2, said by the numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from pipeline.report.numbers import number
from pipeline.report.paper_values import OBJECTIVES
from pipeline.report.planners import is_network, name_of
from pipeline.report.results import FLOWN, PREDICTED

NEAR = 2.0
"""Factor either way within which a number is called near the paper's."""

COLLISION_SHARE, FUEL_SHARE = 0.5, 0.1
"""What the tuned networks are held to: shares of the paper's collisions and fuel."""


@dataclass(frozen=True)
class Compared:
    """One network's collisions and fuel over the paper's.

    Attributes:
        name: of the network.
        collisions: average collisions over the paper's.
        fuel: average fuel over the paper's.
    """

    name: str
    collisions: float
    fuel: float


def paper_comparison(summary: pd.DataFrame) -> str:
    """A paragraph in Markdown on both recipes at the paper's swarm size; empty without networks.

    Args:
        summary: the rows of the paper's swarm size, from ``summarize``.
    """
    faithful = _compared(summary, "paper", PREDICTED)
    tuned = _compared(summary, "tuned", FLOWN)
    return " ".join([*_faithful(faithful), *_tuned(tuned)])


def _compared(summary: pd.DataFrame, recipe: str, reading: str) -> list[Compared]:
    known = summary["planner"].map(lambda p: p in OBJECTIVES and is_network(p))
    rows = summary[known & (summary["recipe"] == recipe) & (summary["reading"] == reading)]
    return [
        Compared(
            name_of(planner),
            collisions / OBJECTIVES[planner].collisions_mean,
            fuel / OBJECTIVES[planner].fuel_mean,
        )
        for planner, collisions, fuel in zip(
            rows["planner"], rows["collisions_mean"], rows["fuel_mean"], strict=True
        )
    ]


def _faithful(rows: Sequence[Compared]) -> list[str]:
    """Where the paper's recipe lands near the paper's rows, in the paper's own reading."""
    if not rows:
        return []
    said = [
        f"{what} are within a factor of {NEAR:g} of the paper's for {_named(near)}"
        if what == "collisions"
        else f"{what} is for {_named(near)}"
        for what, near in (
            ("collisions", [r.name for r in rows if _near(r.collisions)]),
            ("fuel", [r.name for r in rows if _near(r.fuel)]),
        )
    ]
    collisions, fuel = (sorted(getattr(r, key) for r in rows) for key in ("collisions", "fuel"))
    return [
        f"**The paper's recipe beside the paper.** As predicted, {' and '.join(said)}; collisions "
        f"are {number(collisions[0])} to {number(collisions[-1])} and fuel {number(fuel[0])} to "
        f"{number(fuel[-1])} times the paper's. The paper states neither orbit nor step, neither "
        "scaling nor learning rate nor how it reads fuel off a prediction, and fuel hangs on the "
        "velocities, which a loss in SI units hardly sees: see docs/paper.md."
    ]


def _tuned(rows: Sequence[Compared]) -> list[str]:
    """Whether every tuned network betters the paper's by as much as it is held to."""
    if not rows:
        return []
    fewer = [r for r in rows if r.collisions <= COLLISION_SHARE]
    cheaper = [r for r in rows if r.fuel <= FUEL_SHARE]
    most = max(rows, key=lambda r: r.collisions)
    dearest = max(rows, key=lambda r: r.fuel)
    return [
        f"**The tuned recipe beside the paper.** Flown, {len(fewer)} of {len(rows)} networks have "
        f"at most half the paper's collisions (most: {most.name}, {number(most.collisions)} times "
        f"the paper's) and {len(cheaper)} of {len(rows)} need at most a tenth of its fuel (most: "
        f"{dearest.name}, {number(dearest.fuel)} times the paper's)."
    ]


def _near(factor: float) -> bool:
    return 1 / NEAR <= factor <= NEAR


def _named(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"
