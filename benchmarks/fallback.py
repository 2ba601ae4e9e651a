"""Time and quality of plans by the network, by the network and one convex solve, and the expert.

    python -m benchmarks.fallback --out reports/bench

Planners take turns on the same scenarios, planned in batches, so that the machine's load affects
all alike; times are CPU times of one core and include certificates, except in "network answers".
Prints that table and those of other time grids and orbits, which are the figures of the packaged
refiner's card too, and writes fallback.json.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from time import process_time

import numpy as np
import typer
from rich.progress import track
from threadpoolctl import threadpool_limits

from benchmarks.tables import BENCH, OutOption, TableRow, quality, quartiles, show, write_json
from pipeline.expert import FIRST_SAFE, Settings, solve_many
from pipeline.networks.refiner.model import TrainedRefiner, packaged
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import radius_at
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.plan.plan import SOLVED, Plan
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements
from pipeline.planners.classical import BASELINES
from pipeline.planners.network import ONE_SOLVE, FallbackPlanner, NetworkPlanner
from pipeline.scenario import Scenario, draw

COUNTS = (("rings", 10, 1000), ("rings", 30, 200), ("rings", 100, 50), ("dense", 10, 300))
"""Family, swarm size and number of scenarios."""

TOGETHER = 5000  # craft of the scenarios that are planned together
TURNS = 3

GRIDS = [replace(Problem(), nodes=T) for T in (6, 8, 11, 16, 21)]
GRIDS += [replace(Problem(), time_step=step) for step in (60.0, 90.0, 180.0, 240.0)]
"""Other time grids."""

ECCENTRICITIES = (0.0, 0.01, 0.1, 0.5)
SWARMS = (("rings", 10, 200), ("rings", 30, 100), ("dense", 10, 200), ("dense", 30, 100))
"""Of orbits that the network was not trained for, and the swarms planned about each."""

Plans = Callable[[Sequence[Scenario]], list[Plan]]


def main(out: OutOption = BENCH) -> None:
    """Run all and print the tables."""
    flown = NetworkPlanner(packaged(), "network")
    with threadpool_limits(1):
        compared = [_compared(flown, *count) for count in COUNTS]
    rows = [row for some in compared for row in some]
    show("From the network to the expert", rows)
    grids = [_grid(flown, grid) for grid in track(GRIDS, "other time grids")]
    show("100 validation scenarios of other time grids, n = 10", grids)
    both = list(product(SWARMS, ECCENTRICITIES))
    orbits = [_orbit(flown, *swarm, e) for swarm, e in track(both, "other orbits")]
    show("About other orbits, with J2", orbits)
    write_json(out / "fallback.json", {"reference": rows, "grids": grids, "orbits": orbits})


def rule(rounds: int, requirements: Requirements = AT_ALL_TIMES) -> NetworkPlanner:
    """The refiner's rounds without its network, to show what learning adds."""
    return NetworkPlanner(TrainedRefiner(None, rounds, Problem(), ""), "rule", requirements)


def _compared(flown: NetworkPlanner, family: str, n: int, count: int) -> list[TableRow]:
    scenarios = [draw(family, 0, n, k, Problem(), "test") for k in range(count)]
    own = next(baseline for baseline in BASELINES if baseline.name == "decoupled optimum")
    planners: dict[str, Plans] = {
        "network answers": lambda some: _answer(flown, some),
        "decoupled optima": own.plan,
        "rule, no learning": rule(packaged().rounds).plan,
        "network": flown.plan,
        "network + one solve": lambda some: _one_solve(flown, some),
        "fallback": FallbackPlanner(flown).plan,
        "expert, first safe": lambda some: solve_many(some, settings=FIRST_SAFE),
        "expert": lambda some: solve_many(some, settings=Settings()),
    }
    parts = [scenarios[k : k + TOGETHER // n] for k in range(0, count, TOGETHER // n)]
    times: dict[str, list[float]] = {name: [] for name in planners}
    plans: dict[str, list[Plan]] = {}
    for _ in range(TURNS):
        for name, plan in planners.items():
            started = process_time()
            plans[name] = [made for part in parts for made in plan(part)]
            times[name].append((process_time() - started) / count)
    plans["network answers"] = plans["network"]
    return [
        {
            **{"family": family, "n": n, "scenarios": count, "planner": name},
            **_speed(np.array(taken)),
            **quality(plans[name]),
            "fuel/expert": _over(plans[name], plans["expert"]),
            "made_by": " ".join(
                str(k) for _, k in Counter(plan.planner for plan in plans[name]).most_common()
            ),
        }
        for name, taken in times.items()
    ]


def _one_solve(flown: NetworkPlanner, scenarios: Sequence[Scenario]) -> list[Plan]:
    """One convex solve of every scenario, whether its seed was safe or not."""
    seeds = [plan.states for plan in flown.plan(scenarios)]
    return solve_many(scenarios, seeds, ONE_SOLVE)


def _answer(flown: NetworkPlanner, scenarios: Sequence[Scenario]) -> list[Plan]:
    """Run the network alone, without certificates, to time it."""
    initial, goal = (np.stack([getattr(s, end) for s in scenarios]) for end in ("initial", "goal"))
    flown.model.answer(initial, goal, scenarios[0].problem.collision_radius)
    return []


def _speed(seconds: np.ndarray) -> TableRow:
    median = float(np.median(seconds))
    return {"ms": 1e3 * median, "quartiles_ms": quartiles(1e3 * seconds), "a_second": 1 / median}


def _over(plans: Sequence[Plan], others: Sequence[Plan]) -> str:
    pairs = zip(plans, others, strict=True)
    safe = [(a.certificate, b.certificate) for a, b in pairs if a.status == b.status == SOLVED]
    return f"{np.mean([one.fuel / other.fuel for one, other in safe] or [np.nan]):.4f}"


def _grid(flown: NetworkPlanner, problem: Problem) -> TableRow:
    scenarios = [draw("rings", 0, 10, k, problem, "valid") for k in range(100)]
    plans, expert = flown.plan(scenarios), solve_many(scenarios, settings=Settings())
    return {
        "T": problem.nodes,
        "time_step_s": problem.time_step,
        **quality(plans),
        "expert": quality(expert)["fuel/bound"],
    }


def _orbit(flown: NetworkPlanner, family: str, n: int, count: int, e: float) -> TableRow:
    """Test scenarios about orbits with their circle's radius at perigee, from anywhere on them."""
    size, rng, scenarios = radius_at(Problem().mean_motion) / (1 - e), np.random.default_rng(0), []
    for k in range(count):
        orbit = ReferenceOrbit(size, e, 97.4, 0.0, 90.0, float(rng.uniform(0.0, 360.0)))
        drawn = draw(family, 0, n, k, Problem(), "test")
        scenarios.append(replace(drawn, problem=drawn.problem.about(orbit)))
    plans = [plan for one in scenarios for plan in flown.plan([one])]
    after = [plan for one in scenarios for plan in FallbackPlanner(flown).plan([one])]
    return {
        **{"family": family, "n": n, "e": e, "scenarios": count},
        **quality(plans),
        "safe after": f"{np.mean([plan.status == SOLVED for plan in after]):.1%}",
        "fuel/bound after": quality(after)["fuel/bound"],
    }


if __name__ == "__main__":
    typer.run(main)
