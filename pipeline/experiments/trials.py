"""Experiments 1 and 2: every planner on the same test scenarios of each swarm size."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
import pandas as pd
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from pipeline.arrays import Array
from pipeline.experiments.rows import FLOWN, PLAN, PREDICTED, Trial
from pipeline.orbit.separation import node_collisions, pair_conflicts
from pipeline.orbit.transfer import dynamics_defect, fuel, implied_controls
from pipeline.plan import SOLVED, Plan, is_safe
from pipeline.planners.planner import Planner
from pipeline.progress import SILENT, Progress
from pipeline.scenario import Scenario

NAN = float("nan")


@runtime_checkable
class Predictor(Protocol):
    """Whatever answers with trajectories that need not be flyable."""

    def predict(
        self, initial: Float[Array, "N n 6"], goal: Float[Array, "N n 6"]
    ) -> Float[Array, "N n T 6"]:
        """Node states, m and m/s."""
        ...


@dataclass(frozen=True)
class EvaluatedPlanner:
    """A planner in the experiments.

    Attributes:
        planner: what plans.
        recipe: of its training, where it has one.
        training_seed: of that training, or 0.
        predictor: a network, whose raw output is judged beside its plans, as in the paper.
    """

    planner: Planner
    recipe: str = ""
    training_seed: int = 0
    predictor: Predictor | None = None

    @property
    def label(self) -> str:
        """Name and recipe; trainings that differ in their seed alone share it."""
        return f"{self.planner.name} {self.recipe}".strip()


def run_trials(
    planners: Sequence[EvaluatedPlanner],
    scenarios: Sequence[Scenario],
    *,
    timed: int = 0,
    progress: Progress = SILENT,
) -> pd.DataFrame:
    """All planners on scenarios of one problem and one size: a row a trial, columns of Trial.

    Args:
        planners: who plans.
        scenarios: of one problem and one n.
        timed: how many of the scenarios are planned once more one at a time, the planners in
            turn so that the machine's noise falls on all alike, to take the time.
        progress: told of each planner.
    """
    seconds = _times(planners, scenarios[:timed])
    rows: list[Trial] = []
    for one, taken in zip(planners, seconds, strict=True):
        plans = one.planner.plan(scenarios)
        taken += [NAN] * (len(plans) - len(taken))
        planned = [
            _trial(one, k, scenarios[k], plan, took)
            for k, (plan, took) in enumerate(zip(plans, taken, strict=True))
        ]
        if one.predictor is not None:
            rows += _predicted(one.predictor, scenarios, planned)
        rows += planned
        progress.done(note=f"n={scenarios[0].n}")
    return pd.DataFrame(rows)


def _times(
    planners: Sequence[EvaluatedPlanner], scenarios: Sequence[Scenario]
) -> list[list[float]]:
    """Seconds to plan each scenario alone, by planner, all of them on one thread."""
    seconds: list[list[float]] = [[] for _ in planners]
    with threadpool_limits(1):
        for one in planners if scenarios else ():
            one.planner.plan(scenarios[:1])  # warm up
        for scenario in scenarios:
            for taken, one in zip(seconds, planners, strict=True):
                taken.append(one.planner.plan([scenario])[0].timing["plan"])
    return seconds


def _trial(
    one: EvaluatedPlanner, trial: int, scenario: Scenario, plan: Plan, seconds: float
) -> Trial:
    certificate = plan.certificate
    return Trial(
        planner=one.planner.name,
        recipe=one.recipe,
        training_seed=one.training_seed,
        reading=PLAN if one.predictor is None else FLOWN,
        n=scenario.n,
        trial=trial,
        node_collisions=certificate.node_collisions,
        pair_conflicts=float(pair_conflicts(plan.states, plan.controls, scenario.problem)),
        safe=plan.status == SOLVED and is_safe(certificate, scenario.problem),
        min_separation=NAN if certificate.min_separation is None else certificate.min_separation,
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
            pair_conflicts=NAN,
            safe=False,
            min_separation=NAN,
            fuel=float(used[trial]),
            boundary_error=float(np.abs(ends[:, trial, :, :3]).max()),
            dynamics_error=float(np.abs(defect[trial, ..., :3]).max()),
            seconds=NAN,
            convex_solves=0,
        )
