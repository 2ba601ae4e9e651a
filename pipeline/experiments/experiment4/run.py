"""Experiment 4: what networks do at transfer times that they were not trained for."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd

from pipeline.experiments.trials import Entrant, run_trials
from pipeline.orbit.problem import Problem
from pipeline.progress import SILENT, Progress
from pipeline.scenario import Scenario

WAYS = NODES, TIME_STEP = "nodes", "time_step"
"""What is varied: T at the Δt of the training, or Δt at its T."""

TIME = ("varied", *WAYS)
"""Columns that a transfer time is known by: the way to it, T and Δt in s."""

EntrantsOn = Callable[[Problem], Sequence[Entrant]]
"""Who can take part in a problem: experts and baselines always, networks where they fit."""


@dataclass(frozen=True)
class Variation:
    """A problem that differs from the training's in one number.

    Attributes:
        varied: NODES or TIME_STEP.
        problem: orbit and safety of the training, with another T or another Δt.
    """

    varied: str
    problem: Problem


def variations(
    problem: Problem, nodes: Sequence[int], time_steps: Sequence[float] | None = None
) -> list[Variation]:
    """Every T at the Δt of a problem, and every Δt at its T.

    Args:
        problem: that of the training.
        nodes: numbers of nodes T.
        time_steps: Δt in s, or None for those that take as long as the numbers of nodes.

    Raises:
        InputError: for fewer than 3 nodes, or a step that is no positive number.
    """
    if time_steps is None:
        time_steps = [problem.time_step * (T - 1) / problem.intervals for T in nodes]
    return [Variation(NODES, replace(problem, nodes=T)) for T in nodes] + [
        Variation(TIME_STEP, replace(problem, time_step=step)) for step in time_steps
    ]


def run_transfer_times(
    entrants_on: EntrantsOn,
    scenarios: Sequence[Scenario],
    varied: Sequence[Variation],
    *,
    progress: Progress = SILENT,
) -> pd.DataFrame:
    """All entrants that fit, in every variation, on the same initial and goal states.

    The ends stay what they are, since passive formations depend on the orbit alone.

    Args:
        entrants_on: who can take part in a problem.
        scenarios: of one problem and one n.
        varied: the problems.
        progress: told of each of them.

    Returns:
        A row a trial: ``TIME`` and the columns of Trial.
    """
    tables = []
    for variation in varied:
        problem = variation.problem
        moved = [replace(scenario, problem=problem) for scenario in scenarios]
        table = run_trials(entrants_on(problem), moved)
        known = (variation.varied, problem.nodes, problem.time_step)
        time: dict[str, Any] = dict(zip(TIME, known, strict=True))
        tables.append(table.assign(**time)[[*TIME, *table.columns]])
        progress.done(note=f"T = {problem.nodes}, Δt = {problem.time_step:g} s")
    return pd.concat(tables, ignore_index=True)
