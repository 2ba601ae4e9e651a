"""Runs of experiment 5: plans flown in other worlds, with errors, in open and closed loop."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, fields, replace
from itertools import islice, product

import numpy as np
import pandas as pd

from pipeline.errors import InputError, check_range
from pipeline.experiments import records
from pipeline.experiments.records import LINEAR, MARGIN, NO_ERRORS, Flight
from pipeline.experiments.trials import EvaluatedPlanner
from pipeline.figures.labels import BASELINES
from pipeline.flight.conditions import Conditions
from pipeline.flight.errors import COLD_GAS, Errors
from pipeline.flight.loops import Loop, flight_loops
from pipeline.flight.trials import SIZE
from pipeline.flight.world import LinearWorld, World
from pipeline.parallel.workers import Workers
from pipeline.progress import SILENT, Progress
from pipeline.scenario import Scenario
from pipeline.scenario.families import SEEDS

MEASURED = ("goal_error", "goal_velocity_error", "delta_v", "missed_burns")
MAGNITUDES = {NO_ERRORS: Errors(), records.WITH_ERRORS: COLD_GAS}
"""Errors of thrust and navigation by name."""

MOST_FLIGHTS = 10_000
"""Of one scenario, side by side."""


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

    Args:
        planners: who plans.
        scenarios: of one problem and one n.
        flights: draws of errors for each scenario; without errors one flight says all.
        seed: root seed of errors, and of where on their orbits references begin.
        workers: what to fly with; all cores of this machine by default.
        progress: told of each scenario.

    Returns:
        A row a flight, columns of Flight; the same for any number of workers.

    Raises:
        InputError: for no flights, or a seed that is none.
    """
    check_range("flights", flights, 1, MOST_FLIGHTS)
    if not 0 <= seed < SEEDS:
        raise InputError(f"seed is {seed}; expected 0 to {SEEDS - 1}.")
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
    """The rows of a scenario."""
    worlds = worlds_of(asked.scenario, asked.seed, asked.trial)
    tables = []
    for one in asked.planners:
        loops, bound = _loops(one, asked.scenario)
        for world, errors, loop in product(records.WORLDS, MAGNITUDES, loops):
            if errors == NO_ERRORS and loop.name == MARGIN:
                continue
            rows = _fly(asked, worlds[world], MAGNITUDES[errors], loop)
            rows = rows.assign(world=world, errors=errors, loop=loop.name, delta_v_bound=bound)
            tables.append(
                rows.assign(
                    planner=one.planner.name, recipe=one.recipe, training_seed=one.training_seed
                )
            )
    columns = [field.name for field in fields(Flight)]
    return pd.concat(tables).assign(n=asked.scenario.n, trial=asked.trial)[columns]


def _loops(one: EvaluatedPlanner, scenario: Scenario) -> tuple[list[Loop], float]:
    """The loops that a planner flies in, and the least Δv of any plan, m/s."""
    planner = one.planner
    (plan,) = planner.plan([scenario])
    loops = flight_loops(scenario, plan.controls, COLD_GAS, planner)
    some = islice(loops, 2) if planner.name in BASELINES else loops
    return list(some), plan.certificate.fuel_lower_bound * scenario.problem.time_step


def _fly(asked: ScenarioFlights, world: World, errors: Errors, loop: Loop) -> pd.DataFrame:
    """The flights of one loop in one world, side by side."""
    scenario, count = asked.scenario, 1 if errors == Errors() else asked.flights
    problem, first = scenario.problem, asked.trial * asked.flights
    flown = loop.fly(scenario, world, errors, range(first, first + count), asked.seed)
    apart, unsafe = flown["min_separation"], flown["unsafe_replans"].astype(float)
    return pd.DataFrame(
        {
            "flight": np.arange(count),
            "min_separation": apart,
            "within_radius": apart <= problem.collision_radius,
            "within_size": apart <= SIZE,
            **{name: flown[name] for name in MEASURED},
            "unsafe_replans": unsafe if loop.planner else np.nan,
            "margin": loop.margin,
        }
    )
