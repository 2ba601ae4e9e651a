"""Runs of experiment 5: plans flown in other worlds, with errors, in open and closed loop."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice, product

import numpy as np
import pandas as pd

from pipeline.errors import check_range
from pipeline.experiments import records
from pipeline.experiments.parts import FinishedParts, Part, finish_parts
from pipeline.experiments.trials import EvaluatedPlanner
from pipeline.figures.labels import BASELINES
from pipeline.flight import FEEDBACK, MARGIN, OPEN
from pipeline.flight.errors import COLD_GAS, Errors, check_seed
from pipeline.flight.loops import Loop, TrialSettings, flight_loops
from pipeline.flight.trials import SIZE
from pipeline.flight.world import Conditions, LinearWorld, NonlinearWorld, World
from pipeline.orbit.reference import radius_at
from pipeline.parallel.workers import ALL_CORES, Workers
from pipeline.plan.plan import SOLVED, Plan
from pipeline.plan.requirements import RiskLimit
from pipeline.planners.as_flown import AsFlown
from pipeline.planners.planner import Planner, requiring
from pipeline.scenario import Scenario

MEASURED = ["min_separation", "goal_error", "goal_velocity_error", "delta_v", "missed_burns"]
MAGNITUDES = {records.NO_ERRORS: Errors(), records.WITH_ERRORS: COLD_GAS}  # of errors, by name
MOST_FLIGHTS = 10_000  # of one scenario, side by side


def run_flights(
    planners: Sequence[EvaluatedPlanner],
    scenarios: Sequence[Scenario],
    *,
    flights: int,
    larger: Sequence[Scenario] = (),
    seed: int = 0,
    workers: Workers = ALL_CORES,
    kept: FinishedParts | None = None,
) -> pd.DataFrame:
    """Plans of all planners flown in all worlds, with and without errors, in all loops.

    Each planner replans its own plans. With feedback a plan is made as flown, for RISK with the
    same errors. Baselines know no separation: they have no loop with margin, and with feedback fly
    their one plan. Other planners also plan as flown about each of ORBITS; these plans are flown
    there without errors in open loop, beside those for the linear model.

    The scenarios are of one problem and one n; ``larger`` ones, of another n, fly in the world of
    TYPICAL alone. Each has ``flights`` flights with different errors, and one without errors. The
    seed determines the errors and where on their orbits references begin. Returns a row for each
    flight with the columns of Flight, whatever the workers.
    """
    check_flights(flights, seed)
    sizes = ((scenarios, records.WORLDS), (larger, (records.TYPICAL,)))
    parts = [
        Part((k, one, worlds), one.n, f"n={one.n}")
        for some, worlds in sizes
        for k, one in enumerate(some)
    ]
    flown = partial(_flown, planners, flights, seed)
    tables = finish_parts("flights", flown, parts, workers=workers, kept=kept)
    return pd.concat(tables, ignore_index=True)


def check_flights(flights: int, seed: int) -> None:
    """Refuse a number of flights or a root seed out of range with an InputError."""
    check_range("flights", flights, 1, MOST_FLIGHTS)
    check_seed(seed)


def worlds_of(scenario: Scenario, seed: int, trial: int) -> dict[str, NonlinearWorld]:
    """The nonlinear worlds of a scenario, by name.

    The reference's argument of perigee and its argument of latitude at the first node are drawn
    uniformly for each scenario, the same for all eccentricities. Nearly circular orbits have
    the scenario's mean motion; the others, which would then meet the Earth, have their perigee at
    the radius of the circle with that mean motion.
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


def _flown(
    planners: Sequence[EvaluatedPlanner],
    flights: int,
    seed: int,
    part: tuple[int, Scenario, Sequence[str]],
) -> pd.DataFrame:
    """Rows of experiment 5 for one scenario: the flights of ``_cases`` of every planner."""
    trial, scenario, in_loops = part
    problem, first = scenario.problem, trial * flights
    nonlinear = worlds_of(scenario, seed, trial)
    worlds: dict[str, World] = {records.LINEAR: LinearWorld(problem.dynamics), **nonlinear}
    tables = []
    for evaluated in planners:
        cases = _cases(evaluated.planner, scenario, in_loops, nonlinear)
        for plan, planned, world, errors, loop in cases:
            count = 1 if errors == records.NO_ERRORS else flights
            draws = range(first, first + count)
            of = TrialSettings(scenario, worlds[world], MAGNITUDES[errors], seed)
            flown = of.fly(loop, draws)
            unsafe = flown["unsafe_replans"].astype(float) if loop.planner else np.nan
            with_risk = loop.name == FEEDBACK and evaluated.planner.name not in BASELINES
            if with_risk or planned == records.AS_FLOWN:
                unsafe = float(plan.status != SOLVED)
            rows = {name: flown[name] for name in MEASURED} | {
                "planned": planned,
                "world": world,
                "errors": errors,
                "loop": loop.name,
                "flight": range(count),
                "within_radius": flown["min_separation"] <= problem.collision_radius,
                "within_size": flown["min_separation"] <= SIZE,
                "unsafe_replans": unsafe,
                "planner": evaluated.planner.name,
                "recipe": evaluated.recipe,
                "training_seed": evaluated.training_seed,
                "delta_v_bound": plan.certificate.fuel_lower_bound * problem.time_step,
            }
            tables.append(pd.DataFrame(rows))
    columns = list(records.TABLES["flights"])
    return pd.concat(tables).assign(n=scenario.n, trial=trial)[columns]


def _cases(
    planner: Planner,
    scenario: Scenario,
    in_loops: Sequence[str],
    worlds: Mapping[str, NonlinearWorld],
) -> Iterator[tuple[Plan, str, str, str, Loop]]:
    """The flights of a planner's plans: plan, the model that it is made for, world, errors, loop.

    In the worlds ``in_loops`` they fly in all loops, with and without errors; elsewhere in open
    loop without errors.
    """
    baseline, exact = planner.name in BASELINES, records.NO_ERRORS
    (plan,) = planner.plan([scenario])
    every = flight_loops(plan, COLD_GAS, planner)
    loops = list(islice(every, 2) if baseline else every)
    for world, errors, loop in product(in_loops, MAGNITUDES, loops):
        if errors != exact or loop.name != MARGIN:
            yield plan, records.LINEAR, world, errors, loop
    for world in in_loops:
        tracked, planned = plan, records.LINEAR
        if not baseline:
            tracked, planned = _with_risk(planner, scenario, worlds.get(world))
        loop = Loop(FEEDBACK, tracked.controls, tracked.states)
        yield tracked, planned, world, records.WITH_ERRORS, loop
    for orbit, world_of_orbit in {} if baseline else worlds.items():
        if orbit not in in_loops:
            yield plan, records.LINEAR, orbit, exact, Loop(OPEN, plan.controls)
        (flown,) = AsFlown(planner, world_of_orbit.orbit).plan([scenario])
        yield flown, records.AS_FLOWN, orbit, exact, Loop(OPEN, flown.controls)


def _with_risk(
    planner: Planner, scenario: Scenario, world: NonlinearWorld | None
) -> tuple[Plan, str]:
    """A plan for RISK with feedback, and its model: the given world's, or the linear one."""
    limit = RiskLimit(records.RISK, closed_loop=True, errors=COLD_GAS)
    careful = requiring(planner, replace(planner.requirements, risk=limit))
    if world is None:
        return careful.plan([scenario])[0], records.LINEAR
    return AsFlown(careful, world.orbit).plan([scenario])[0], records.AS_FLOWN
