"""Runs of experiment 5: plans flown in other worlds, with errors, in open and closed loop."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import islice, product

import numpy as np
import pandas as pd

from pipeline.errors import check_range
from pipeline.experiments import records
from pipeline.experiments.records import LINEAR, MARGIN, NO_ERRORS
from pipeline.experiments.trials import EvaluatedPlanner
from pipeline.figures.labels import BASELINES
from pipeline.flight.conditions import Conditions
from pipeline.flight.errors import COLD_GAS, Errors, check_seed
from pipeline.flight.loops import flight_loops
from pipeline.flight.trials import SIZE
from pipeline.flight.world import LinearWorld, World
from pipeline.parallel.workers import Workers
from pipeline.progress import SILENT, Progress
from pipeline.scenario import Scenario

MEASURED = ["min_separation", "goal_error", "goal_velocity_error", "delta_v", "missed_burns"]
MAGNITUDES = {NO_ERRORS: Errors(), records.WITH_ERRORS: COLD_GAS}  # of errors, by name
MOST_FLIGHTS = 10_000  # of one scenario, side by side


@dataclass(frozen=True, eq=False)
class ScenarioFlights:
    """All flights of one scenario: its number, who plans, draws of errors and their root seed."""

    trial: int
    scenario: Scenario
    planners: Sequence[EvaluatedPlanner]
    flights: int
    seed: int


def run_flights(
    planners: Sequence[EvaluatedPlanner],
    scenarios: Sequence[Scenario],
    *,
    flights: int,
    seed: int = 0,
    workers: Workers | None = None,
    progress: Progress = SILENT,
) -> pd.DataFrame:
    """Plans of all planners flown in all worlds, with and without errors, in all loops.

    A planner plans anew for itself. Baselines know no separation, so none has a loop with margin.

    Scenarios are of one problem and one n. So many flights are draws of errors for each of them;
    without errors one says all. The seed is the root of errors, and of where on their orbits
    references begin. A row a flight, columns of Flight; the same for any number of workers, by
    default all cores of this machine. Progress is told of each scenario. InputError for no flights,
    or a seed that is none.
    """
    check_range("flights", flights, 1, MOST_FLIGHTS)
    check_seed(seed)
    asked = [ScenarioFlights(k, one, planners, flights, seed) for k, one in enumerate(scenarios)]
    progress.expect(len(asked))
    tables: dict[int, pd.DataFrame] = {}
    with closing((workers or Workers()).work(_flown, asked, lambda _: b"", progress)) as results:
        for one, rows in results:
            tables[one.trial] = rows
            progress.done()
    return pd.concat([tables[k] for k in sorted(tables)], ignore_index=True)


def worlds_of(scenario: Scenario, seed: int, trial: int) -> dict[str, World]:
    """The worlds of a scenario, by name.

    Where the reference's perigee is, and where it is itself at the first node, is drawn uniformly
    for each scenario, the same for all eccentricities; else conditions are the usual ones.
    """
    perigee, latitude = np.random.default_rng([seed, trial]).uniform(0.0, 360.0, 2).tolist()
    usual = Conditions(argument_of_perigee_deg=perigee, argument_of_latitude_deg=latitude)
    nonlinear = {
        name: replace(usual, eccentricity=e).world(scenario.problem, scenario.n)
        for name, e in records.ECCENTRICITIES.items()
    }
    return {LINEAR: LinearWorld(scenario.problem.dynamics), **nonlinear}


def _flown(asked: ScenarioFlights, _: bytes) -> pd.DataFrame:
    """The rows of a scenario; the flights of a loop in a world side by side."""
    scenario, problem, first = asked.scenario, asked.scenario.problem, asked.trial * asked.flights
    worlds = worlds_of(scenario, asked.seed, asked.trial)
    tables = []
    for one in asked.planners:
        (plan,) = one.planner.plan([scenario])
        every = flight_loops(scenario, plan.controls, COLD_GAS, one.planner)
        loops = list(islice(every, 2) if one.planner.name in BASELINES else every)
        for world, errors, loop in product(records.WORLDS, MAGNITUDES, loops):
            if errors == NO_ERRORS and loop.name == MARGIN:
                continue
            count = 1 if errors == NO_ERRORS else asked.flights
            draws = range(first, first + count)
            flown = loop.fly(scenario, worlds[world], MAGNITUDES[errors], draws, asked.seed)
            unsafe = flown["unsafe_replans"].astype(float)
            rows = pd.DataFrame({name: flown[name] for name in MEASURED}).assign(
                world=world,
                errors=errors,
                loop=loop.name,
                margin=loop.margin,
                flight=range(count),
                within_radius=flown["min_separation"] <= problem.collision_radius,
                within_size=flown["min_separation"] <= SIZE,
                unsafe_replans=unsafe if loop.planner else np.nan,
                planner=one.planner.name,
                recipe=one.recipe,
                training_seed=one.training_seed,
                delta_v_bound=plan.certificate.fuel_lower_bound * problem.time_step,
            )
            tables.append(rows)
    columns = list(records.TABLES["flights"])
    return pd.concat(tables).assign(n=scenario.n, trial=asked.trial)[columns]
