"""Runs of experiments 1, 2 and 4: every planner on the same scenarios."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np
import pandas as pd

from pipeline.arrays import Array, Float
from pipeline.experiments import records
from pipeline.experiments.parts import FinishedParts, Part, finish_parts
from pipeline.experiments.records import FLOWN, NODES, PLAN, PREDICTED, TIME_STEP, Trial
from pipeline.networks.document import EndStates
from pipeline.orbit.problem import Problem
from pipeline.orbit.separation import node_collisions, pair_conflicts
from pipeline.orbit.transfer import dynamics_defect, fuel, implied_controls, state_weight
from pipeline.parallel.workers import ALL_CORES, Workers
from pipeline.plan.judge import is_safe
from pipeline.plan.plan import SOLVED, Plan
from pipeline.planners.planner import Planner
from pipeline.scenario import Scenario

Predictor = Callable[[EndStates, EndStates], Float[Array, "b n T 6"]]
"""From initial and goal states to node states, m and m/s, which need not obey the dynamics."""


@dataclass(frozen=True)
class EvaluatedPlanner:
    """A planner in the experiments."""

    planner: Planner
    recipe: str = ""  # of its training, where it has one
    training_seed: int = 0  # of that training
    predictor: Predictor | None = None  # of its raw output, evaluated too, as in the paper

    @property
    def label(self) -> str:
        """Name and recipe; trainings that differ in their seed alone share it."""
        return f"{self.planner.name} {self.recipe}".strip()


@dataclass(frozen=True, eq=False)
class Comparison:
    """Planners, and the scenarios of one problem and one size that all of them plan."""

    planners: Sequence[EvaluatedPlanner]
    scenarios: Sequence[Scenario]
    note: str = ""  # for progress


def run_trials(
    comparisons: Sequence[Comparison],
    *,
    timed: int = 0,
    workers: Workers = ALL_CORES,
    kept: FinishedParts | None = None,
) -> list[pd.DataFrame]:
    """A table of each comparison: a row for each trial, columns of Trial.

    The first ``timed`` scenarios of each are planned one at a time by this process before any
    worker begins, the planners in turn so that the machine's load affects all alike. Progress
    counts each planner of each comparison. The tables do not depend on the workers.
    """
    seconds = _times(comparisons, timed, kept)
    parts = [
        Part((evaluated, each.scenarios), each.scenarios[0].n, each.note)
        for each in comparisons
        for evaluated in each.planners
    ]
    tables = finish_parts("plans", _planned, parts, workers=workers, kept=kept)
    for table, taken in zip(tables, seconds, strict=True):
        rows = table.index[table.reading != PREDICTED][: len(taken)]
        table.loc[rows, "seconds"] = taken
    left = iter(tables)
    return [pd.concat(islice(left, len(each.planners)), ignore_index=True) for each in comparisons]


def _planned(part: tuple[EvaluatedPlanner, Sequence[Scenario]]) -> pd.DataFrame:
    """The rows of a planner, those of its raw predictions first; times are left NaN."""
    evaluated, scenarios = part
    plans = evaluated.planner.plan(scenarios)
    flown = [_trial(evaluated, k, plan) for k, plan in enumerate(plans)]
    raw = [] if evaluated.predictor is None else _predicted(evaluated.predictor, scenarios, flown)
    return pd.DataFrame([*raw, *flown])


def _times(
    comparisons: Sequence[Comparison], timed: int, kept: FinishedParts | None
) -> Sequence[Sequence[float]]:
    """Seconds to plan each of the first scenarios alone, by comparison and planner."""
    if not timed:
        return [[] for each in comparisons for _ in each.planners]
    here, make = Workers(jobs=1), partial(_timed, timed)
    parts = [Part(each, each.scenarios[0].n) for each in comparisons]
    tables = finish_parts("times", make, parts, workers=here, kept=kept)
    return [table[name].to_list() for table in tables for name in table]


def _timed(timed: int, comparison: Comparison) -> pd.DataFrame:
    """Seconds to plan the first scenarios: a row each, a column for each planner."""
    planners, scenarios = [one.planner for one in comparison.planners], comparison.scenarios[:timed]
    for planner in planners:
        planner.plan(scenarios)  # warm up: some code runs for near pairs alone
    rows = [
        {str(k): planner.plan([each])[0].timing["plan"] for k, planner in enumerate(planners)}
        for each in scenarios
    ]
    return pd.DataFrame(rows)


def _trial(evaluated: EvaluatedPlanner, trial: int, plan: Plan) -> Trial:
    certificate, scenario = plan.certificate, plan.scenario
    return Trial(
        planner=evaluated.planner.name,
        recipe=evaluated.recipe,
        training_seed=evaluated.training_seed,
        reading=PLAN if evaluated.predictor is None else FLOWN,
        n=scenario.n,
        trial=trial,
        node_collisions=certificate.node_collisions,
        pair_conflicts=float(pair_conflicts(plan.states, plan.controls, scenario.problem)),
        safe=flies_safely(plan),
        min_separation=np.nan if certificate.min_separation is None else certificate.min_separation,
        fuel=certificate.fuel,
        fuel_lower_bound=certificate.fuel_lower_bound,
        boundary_error=certificate.goal_error,
        dynamics_error=certificate.dynamics_error,
        seconds=np.nan,
        convex_solves=plan.convex_solves,
    )


def flies_safely(plan: Plan) -> bool:
    """Whether a plan is solved and keeps craft apart at all times, whatever its requirements."""
    return plan.status == SOLVED and is_safe(plan.certificate, plan.scenario.problem)


def _predicted(
    predictor: Predictor, scenarios: Sequence[Scenario], flown: Sequence[Trial]
) -> Iterator[Trial]:
    """Raw predictions evaluated as in the paper, with their boundary and dynamics errors."""
    problem = scenarios[0].problem
    initial = np.stack([scenario.initial for scenario in scenarios])
    goal = np.stack([scenario.goal for scenario in scenarios])
    states = predictor(initial, goal)
    controls = implied_controls(states, problem)
    # The controls fit positions, so what is left of a violation is in the velocities.
    defect = dynamics_defect(states, controls, problem) * state_weight(problem)
    ends = np.stack([states[..., 0, :] - initial, states[..., -1, :] - goal])
    used, collisions = fuel(controls), node_collisions(states, problem.collision_radius)
    for trial, row in enumerate(flown):
        yield replace(
            row,
            reading=PREDICTED,
            node_collisions=int(collisions[trial]),
            pair_conflicts=np.nan,
            safe=False,
            min_separation=np.nan,
            fuel=float(used[trial]),
            boundary_error=float(np.abs(ends[:, trial, :, :3]).max()),
            dynamics_error=float(np.abs(defect[trial]).max()),
            convex_solves=0,
        )


def variations(
    problem: Problem, nodes: Sequence[int], time_steps: Sequence[float] | None = None
) -> list[tuple[str, Problem]]:
    """Problems with each T at the given Δt and each Δt (s) at the given T, with what varies.

    By default the Δt for which transfers last as long as with these numbers of nodes. InputError
    for fewer than 3 nodes, or a step that is not positive.
    """
    if time_steps is None:
        time_steps = [problem.time_step * (T - 1) / problem.intervals for T in nodes]
    return [(NODES, replace(problem, nodes=T)) for T in nodes] + [
        (TIME_STEP, replace(problem, time_step=step)) for step in time_steps
    ]


def run_transfer_times(
    planners_for: Callable[[Problem], Sequence[EvaluatedPlanner]],
    scenarios: Sequence[Scenario],
    varied: Sequence[tuple[str, Problem]],
    *,
    workers: Workers = ALL_CORES,
    kept: FinishedParts | None = None,
) -> pd.DataFrame:
    """Trials of all planners that fit, in every variation, with the same initial and goal states.

    The ends of the scenarios, of one problem about a circle and one n, stay the same, since
    passive formations depend on the orbit alone. A row a trial: varied, nodes, time_step and the
    columns of Trial.
    """
    comparisons = [
        Comparison(
            planners_for(problem),
            [replace(scenario, problem=problem) for scenario in scenarios],
            f"T = {problem.nodes}, Δt = {problem.time_step:g} s",
        )
        for _, problem in varied
    ]
    tables = run_trials(comparisons, workers=workers, kept=kept)
    found = []
    for (parameter, problem), table in zip(varied, tables, strict=True):
        taken = {"varied": parameter} | {name: getattr(problem, name) for name in records.VARIED}
        found.append(table.assign(**taken)[list(records.TABLES["transfer_times"])])
    return pd.concat(found, ignore_index=True)
