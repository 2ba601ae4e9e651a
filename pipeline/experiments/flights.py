"""Runs of experiment 5: plans flown in other worlds, with errors, in open and closed loop."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, product

import numpy as np
import pandas as pd

from pipeline.errors import check_range
from pipeline.experiments import records
from pipeline.experiments.parts import FinishedParts, Part, done_parts
from pipeline.experiments.trials import EvaluatedPlanner
from pipeline.figures.labels import BASELINES
from pipeline.flight.conditions import Conditions
from pipeline.flight.errors import COLD_GAS, Errors, check_seed
from pipeline.flight.loops import FEEDBACK, OPEN, Loop, flight_loops
from pipeline.flight.trials import SIZE
from pipeline.flight.world import LinearWorld, NonlinearWorld, World
from pipeline.orbit.reference import radius_at
from pipeline.parallel.workers import Workers
from pipeline.plan import SOLVED, Plan, RiskLimit
from pipeline.planners.as_flown import AsFlown
from pipeline.planners.planner import Planner, requiring
from pipeline.progress import SILENT, Progress
from pipeline.scenario import Scenario

MEASURED = ["min_separation", "goal_error", "goal_velocity_error", "delta_v", "missed_burns"]
MAGNITUDES = {records.NO_ERRORS: Errors(), records.WITH_ERRORS: COLD_GAS}  # of errors, by name
MOST_FLIGHTS = 10_000  # of one scenario, side by side


@dataclass(frozen=True, eq=False)
class ScenarioFlights:
    """All flights of one scenario.

    In ``worlds`` plans fly in all loops, with and without errors; elsewhere without in open loop.
    """

    trial: int
    scenario: Scenario
    planners: Sequence[EvaluatedPlanner]
    worlds: Sequence[str]
    flights: int
    seed: int


def run_flights(
    planners: Sequence[EvaluatedPlanner],
    scenarios: Sequence[Scenario],
    *,
    flights: int,
    larger: Sequence[Scenario] = (),
    seed: int = 0,
    workers: Workers | None = None,
    kept: FinishedParts | None = None,
    progress: Progress = SILENT,
) -> pd.DataFrame:
    """Plans of all planners flown in all worlds, with and without errors, in all loops.

    A planner replans its own plans. With feedback a plan is made as flown, for RISK with the same
    errors. Baselines know no separation: they have no loop with margin, and with feedback fly their
    one plan. Plans of others are also made as flown about each of ORBITS, and flown there without
    errors in open loop beside those for the linear model.

    Args:
        planners: who plans.
        scenarios: of one problem and one n.
        flights: draws of errors for each scenario; flights without errors are flown once.
        larger: scenarios of another n, flown in the world of TYPICAL alone.
        seed: root seed of errors, and of where on their orbits references begin.
        workers: by default all cores of this machine; the result does not depend on them.
        kept: parts of an earlier run.
        progress: is told of each scenario.

    Returns:
        A row for each flight, columns of Flight.
    """
    check_range("flights", flights, 1, MOST_FLIGHTS)
    check_seed(seed)
    sizes = ((scenarios, records.WORLDS), (larger, (records.TYPICAL,)))
    parts = [
        Part(ScenarioFlights(k, one, planners, worlds, flights, seed), one.n, f"n={one.n}")
        for some, worlds in sizes
        for k, one in enumerate(some)
    ]
    tables = done_parts("flights", _flown, parts, workers=workers, kept=kept, progress=progress)
    return pd.concat(tables, ignore_index=True)


def worlds_of(scenario: Scenario, seed: int, trial: int) -> dict[str, NonlinearWorld]:
    """The nonlinear worlds of a scenario, by name.

    The reference's argument of perigee and its argument of latitude at the first node are drawn
    uniformly for each scenario, the same for all eccentricities. Orbits near a circle have the
    scenario's mean motion, with which others would meet the Earth: their perigee is that high.
    """
    perigee, latitude = np.random.default_rng([seed, trial]).uniform(0.0, 360.0, 2).tolist()
    usual = Conditions(argument_of_perigee_deg=perigee, argument_of_latitude_deg=latitude)
    problem, found = scenario.problem, {}
    radius = radius_at(problem.mean_motion)
    for name, e in records.ORBITS.items():
        size = radius if name in records.ECCENTRICITIES else radius / (1 - e)
        orbit = replace(usual, eccentricity=e).sized(size)
        found[name] = NonlinearWorld.of(problem.about(orbit), scenario.n)
    return found


@dataclass(frozen=True, eq=False)
class _Way:
    """A plan of some planner, the model it was made for, and how it is flown."""

    plan: Plan
    planned: str
    world: str
    errors: str
    loop: Loop


def _flown(asked: ScenarioFlights) -> pd.DataFrame:
    """The rows of a scenario; the flights of a loop in a world side by side."""
    scenario, problem, first = asked.scenario, asked.scenario.problem, asked.trial * asked.flights
    nonlinear = worlds_of(scenario, asked.seed, asked.trial)
    worlds: dict[str, World] = {records.LINEAR: LinearWorld(problem.dynamics), **nonlinear}
    tables = []
    for one in asked.planners:
        for way in _ways(asked, one, nonlinear):
            loop, count = way.loop, 1 if way.errors == records.NO_ERRORS else asked.flights
            draws = range(first, first + count)
            errors = MAGNITUDES[way.errors]
            flown = loop.fly(scenario, worlds[way.world], errors, draws, asked.seed)
            unsafe = flown["unsafe_replans"].astype(float) if loop.planner else np.nan
            if way.plan.certificate.risk:
                unsafe = float(way.plan.status != SOLVED)
            rows = pd.DataFrame({name: flown[name] for name in MEASURED}).assign(
                planned=way.planned,
                world=way.world,
                errors=way.errors,
                loop=loop.name,
                flight=range(count),
                within_radius=flown["min_separation"] <= problem.collision_radius,
                within_size=flown["min_separation"] <= SIZE,
                unsafe_replans=unsafe,
                planner=one.planner.name,
                recipe=one.recipe,
                training_seed=one.training_seed,
                delta_v_bound=way.plan.certificate.fuel_lower_bound * problem.time_step,
            )
            tables.append(rows)
    columns = list(records.TABLES["flights"])
    return pd.concat(tables).assign(n=scenario.n, trial=asked.trial)[columns]


def _ways(
    asked: ScenarioFlights, one: EvaluatedPlanner, worlds: Mapping[str, NonlinearWorld]
) -> Iterator[_Way]:
    """All ways to fly one planner's plans of a scenario."""
    scenario, baseline = asked.scenario, one.planner.name in BASELINES
    (plan,) = one.planner.plan([scenario])
    every = flight_loops(plan, COLD_GAS, one.planner)
    loops = list(islice(every, 2) if baseline else every)
    for world, errors, loop in product(asked.worlds, MAGNITUDES, loops):
        if errors != records.NO_ERRORS or loop.name != records.MARGIN:
            yield _Way(plan, records.LINEAR, world, errors, loop)
    for world in asked.worlds:
        kept, planned = plan, records.LINEAR
        if not baseline:
            kept, planned = _with_risk(one.planner, scenario, worlds.get(world))
        yield _Way(
            kept, planned, world, records.WITH_ERRORS, Loop(FEEDBACK, kept.controls, kept.states)
        )
    for orbit, there in {} if baseline else worlds.items():
        if orbit not in asked.worlds:
            yield _Way(plan, records.LINEAR, orbit, records.NO_ERRORS, Loop(OPEN, plan.controls))
        (flown,) = AsFlown(one.planner, there.orbit).plan([scenario])
        yield _Way(flown, records.AS_FLOWN, orbit, records.NO_ERRORS, Loop(OPEN, flown.controls))


def _with_risk(
    planner: Planner, scenario: Scenario, world: NonlinearWorld | None
) -> tuple[Plan, str]:
    """A plan for RISK with feedback, as flown in a world or for the linear one, and which."""
    limit = RiskLimit(records.RISK, closed_loop=True, errors=COLD_GAS)
    careful = requiring(planner, replace(planner.requirements, risk=limit))
    if world is None:
        return careful.plan([scenario])[0], records.LINEAR
    return AsFlown(careful, world.orbit).plan([scenario])[0], records.AS_FLOWN
