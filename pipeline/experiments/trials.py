"""Experiments 1 and 2: every planner on the same test scenarios of each swarm size."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Protocol, runtime_checkable

import numpy as np
import pandas as pd
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from pipeline.arrays import Array
from pipeline.orbit.separation import node_collisions, pair_conflicts
from pipeline.orbit.transfer import dynamics_defect, fuel, implied_controls
from pipeline.plan import SOLVED, Plan, is_safe
from pipeline.planners.planner import Planner
from pipeline.progress import SILENT, Progress
from pipeline.scenario import Scenario

PREDICTED = "predicted"
"""Reading of a network's raw output, as in the paper: neither dynamics nor ends need hold."""

FLOWN = "flown"
"""Reading after projection onto the trajectories that obey the dynamics and both ends."""

PLAN = "plan"
"""Reading of a planner whose output is a flyable plan as it stands."""

WARM_UP = 1
"""Plans made and thrown away before a planner is timed."""


@runtime_checkable
class Predictor(Protocol):
    """Whatever answers with trajectories that need not be flyable."""

    def predict(
        self, initial: Float[Array, "N n 6"], goal: Float[Array, "N n 6"]
    ) -> Float[Array, "N n T 6"]:
        """Node states, m and m/s."""
        ...


@dataclass(frozen=True)
class Entrant:
    """A planner in the experiments.

    Attributes:
        planner: what plans.
        recipe: how it was trained, where it was.
        training_seed: of that training; 0 where nothing was trained.
        predictor: what it predicts with, where it is a network; its raw output is then judged
            too, as in the paper.
    """

    planner: Planner
    recipe: str = ""
    training_seed: int = 0
    predictor: Predictor | None = None

    @property
    def label(self) -> str:
        """Name and recipe; trainings that differ in their seed alone share it."""
        return f"{self.planner.name} {self.recipe}".strip()


@dataclass(frozen=True)
class Trial:
    """One planner's answer to one scenario.

    Attributes:
        planner: its name.
        recipe: of its training, or nothing.
        training_seed: of its training, or 0.
        reading: "plan", "flown" or "predicted".
        n: swarm size.
        trial: number of the scenario.
        node_collisions: Eq. 5.
        pair_conflicts: pairs within r_col at any time; not a number where nothing is flown.
        safe: whether separation is proven at all times.
        min_separation: least distance of any pair at any time, m.
        fuel: Eq. 4, m/s²; of raw states, that of the controls nearest to them.
        fuel_lower_bound: m/s².
        boundary_error: largest miss of an initial or goal position, m.
        dynamics_error: largest violation of Eq. 2 in position, m.
        seconds: time to plan this scenario alone on one thread, where it was timed.
        convex_solves: joint convex programs.
    """

    planner: str
    recipe: str
    training_seed: int
    reading: str
    n: int
    trial: int
    node_collisions: int
    pair_conflicts: float
    safe: bool
    min_separation: float
    fuel: float
    fuel_lower_bound: float
    boundary_error: float
    dynamics_error: float
    seconds: float
    convex_solves: int


def run_trials(
    entrants: Sequence[Entrant],
    scenarios: Sequence[Scenario],
    *,
    timed: int = 0,
    progress: Progress = SILENT,
) -> pd.DataFrame:
    """All entrants on scenarios of one problem and one size: a row a trial, columns of Trial.

    Args:
        entrants: the planners.
        scenarios: of one problem and one n.
        timed: how many of the scenarios are planned once more one at a time, the planners in
            turn so that the machine's noise falls on all alike, to take the time.
        progress: told of each entrant.
    """
    seconds = _times(entrants, scenarios[:timed])
    rows: list[Trial] = []
    for entrant, taken in zip(entrants, seconds, strict=True):
        plans = entrant.planner.plan(scenarios)
        untimed = [float("nan")] * (len(plans) - len(taken))
        judged = zip(count(), scenarios, plans, taken + untimed, strict=False)
        planned = [_trial(entrant, *one) for one in judged]
        if entrant.predictor is not None:
            rows += _predicted(entrant.predictor, scenarios, planned)
        rows += planned
        progress.done(note=f"n={scenarios[0].n}")
    return pd.DataFrame(rows)


def _times(entrants: Sequence[Entrant], scenarios: Sequence[Scenario]) -> list[list[float]]:
    """Seconds to plan each scenario alone, by entrant, all of them on one thread."""
    seconds: list[list[float]] = [[] for _ in entrants]
    with threadpool_limits(1):
        for entrant in entrants if scenarios else ():
            entrant.planner.plan(scenarios[:WARM_UP])
        for scenario in scenarios:
            for taken, entrant in zip(seconds, entrants, strict=True):
                taken.append(entrant.planner.plan([scenario])[0].timing["plan"])
    return seconds


def _trial(entrant: Entrant, trial: int, scenario: Scenario, plan: Plan, seconds: float) -> Trial:
    certificate = plan.certificate
    apart = certificate.min_separation
    return Trial(
        planner=entrant.planner.name,
        recipe=entrant.recipe,
        training_seed=entrant.training_seed,
        reading=PLAN if entrant.predictor is None else FLOWN,
        n=scenario.n,
        trial=trial,
        node_collisions=certificate.node_collisions,
        pair_conflicts=float(pair_conflicts(plan.states, plan.controls, scenario.problem)),
        safe=plan.status == SOLVED and is_safe(certificate, scenario.problem),
        min_separation=float("nan") if apart is None else apart,
        fuel=certificate.fuel,
        fuel_lower_bound=certificate.fuel_lower_bound,
        boundary_error=certificate.goal_error,
        dynamics_error=certificate.dynamics_error,
        seconds=seconds,
        convex_solves=plan.convex_solves,
    )


def _predicted(
    predictor: Predictor, scenarios: Sequence[Scenario], flown: Sequence[Trial]
) -> Iterator[Trial]:
    """Raw predictions read as the paper reads them, with their errors beside."""
    problem = scenarios[0].problem
    initial = np.stack([scenario.initial for scenario in scenarios])
    goal = np.stack([scenario.goal for scenario in scenarios])
    states = predictor.predict(initial, goal)
    controls = implied_controls(states, problem)
    defect = dynamics_defect(states, controls, problem)
    ends = np.stack([states[..., 0, :] - initial, states[..., -1, :] - goal])
    used, collisions = fuel(controls), node_collisions(states, problem.collision_radius)
    for trial, row in enumerate(flown):
        yield replace(
            row,
            reading=PREDICTED,
            node_collisions=int(collisions[trial]),
            pair_conflicts=float("nan"),
            safe=False,
            min_separation=float("nan"),
            fuel=float(used[trial]),
            boundary_error=float(np.abs(ends[:, trial, :, :3]).max()),
            dynamics_error=float(np.abs(defect[trial, ..., :3]).max()),
            seconds=float("nan"),
            convex_solves=0,
        )
