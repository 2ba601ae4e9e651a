"""Time and quality of plans: by the network, by it and one convex solve, and by the expert.

    python -m benchmarks.fallback --out reports/bench

Planners take turns on batches of the same scenarios, so that the machine's noise falls on all
alike; times are CPU times of one core, certificates included but where it says "answers". Prints
a table, and writes fallback.json.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from time import process_time
from typing import Annotated

import numpy as np
import torch
import typer
from threadpoolctl import threadpool_limits

from benchmarks.rule import Rule
from benchmarks.tables import Row, quality, quartiles, show, write_json
from pipeline.expert import FIRST_SAFE, Settings, solve_many
from pipeline.networks.model import Model, load
from pipeline.networks.refiner.packaged import TrainedRefiner, packaged
from pipeline.orbit.problem import Problem
from pipeline.plan import Plan
from pipeline.planners.classical import BASELINES
from pipeline.planners.network import ONE_SOLVE, FallbackPlanner, NetworkPlanner
from pipeline.scenario import Scenario, draw

Trained = Model | TrainedRefiner

SEED = 2022
BATCHES = {"rings": {10: 500, 30: 150, 100: 16}, "dense": {10: 150}}
"""Scenarios by family and swarm size, planned together."""

TURNS = 3

Plans = Callable[[Sequence[Scenario]], list[Plan]]


def main(
    out: Annotated[Path, typer.Option(help="Folder for fallback.json.")] = Path("reports/bench"),
    model: Annotated[
        Path | None, typer.Option(help="Folder of a refiner; the packaged one by default.")
    ] = None,
    split: Annotated[str, typer.Option(help="Of the scenarios.")] = "test",
) -> None:
    """Run all and print a table."""
    network = packaged() if model is None else load(model)
    torch.set_num_threads(1)
    with threadpool_limits(1):
        rows = [
            row
            for family, sizes in BATCHES.items()
            for n, count in sizes.items()
            for row in _compared(network, family, n, count, split)
        ]
    show("From the network to the expert", rows)
    write_json(out / "fallback.json", rows)


def _compared(network: Trained, family: str, n: int, count: int, split: str) -> list[Row]:
    """A line for each planner, on scenarios of one size."""
    scenarios = [draw(family, SEED, n, k, Problem(), split) for k in range(count)]
    flown = NetworkPlanner(network, "network")
    rounds = network.rounds if isinstance(network, TrainedRefiner) else network.config["rounds"]
    own = next(baseline for baseline in BASELINES if baseline.name == "own LP")
    planners: dict[str, Plans] = {
        "decoupled optima": own.plan,
        "rule, no learning": Rule(rounds).plan,
        "network": flown.plan,
        "network + one solve": lambda some: _one_solve(flown, some),
        "fallback": FallbackPlanner(flown).plan,
        "expert, first safe": lambda some: solve_many(some, settings=FIRST_SAFE),
        "expert": lambda some: solve_many(some, settings=Settings()),
    }
    times: dict[str, list[float]] = {name: [] for name in ("network answers", *planners)}
    plans: dict[str, list[Plan]] = {}
    for _ in range(TURNS):
        times["network answers"].append(_time(lambda: _answer(network, scenarios))[0])
        for name, plan in planners.items():
            seconds, plans[name] = _time(partial(plan, scenarios))
            times[name].append(seconds)
    rows: list[Row] = []
    for name, taken in times.items():
        who: Row = {"family": family, "n": n, "planner": name}
        worth = _worth(plans.get(name, plans["network"]))
        rows.append(who | _speed(np.array(taken) / count) | worth)
    return rows


def _one_solve(flown: NetworkPlanner, scenarios: Sequence[Scenario]) -> list[Plan]:
    """One convex solve of every scenario, whether its seed was safe or not."""
    seeds = [plan.states for plan in flown.plan(scenarios)]
    return solve_many(scenarios, seeds, ONE_SOLVE)


def _answer(network: Trained, scenarios: Sequence[Scenario]) -> list[Plan]:
    """What the network alone takes, without a certificate."""
    initial, goal = (np.stack([getattr(s, end) for s in scenarios]) for end in ("initial", "goal"))
    network.answer(initial, goal, scenarios[0].problem.collision_radius)
    return []


def _time(work: Callable[[], list[Plan]]) -> tuple[float, list[Plan]]:
    started = process_time()
    made = work()
    return process_time() - started, made


def _speed(seconds: np.ndarray) -> Row:
    """Time an instance, and instances a second."""
    median = float(np.median(seconds))
    return {
        "ms": 1e3 * median,
        "quartiles_ms": quartiles(1e3 * seconds),
        "a_second": 1 / median,
    }


def _worth(plans: Sequence[Plan]) -> Row:
    """What plans are worth, and how many are by whom."""
    by = Counter(plan.planner for plan in plans)
    return {**quality(plans), "made_by": " ".join(str(count) for _, count in by.most_common())}


if __name__ == "__main__":
    typer.run(main)
