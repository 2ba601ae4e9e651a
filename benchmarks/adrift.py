"""What safety after a loss of thrust costs, and how many plans have it without asking.

    python -m benchmarks.adrift --out reports/bench

Plans scenarios of every family twice, without and with passive safety, and prints a line for each:
how many plans have it unasked, for how many scenarios the two ends alone forbid it, how many are
solved, what it costs in fuel, how many rounds of programs and how long it takes, certificate
included, how many plans also stand a loss between nodes, and how close craft come after one (the
median of the plans, m). Writes adrift.json.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Annotated, Any

import numpy as np
import typer
from threadpoolctl import threadpool_limits

from benchmarks.tables import Row, show, write_json
from pipeline.expert import solve
from pipeline.orbit.approaches import side_by_side
from pipeline.orbit.passive_safety import least_after_loss
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly
from pipeline.plan import INFEASIBLE, SOLVED, Plan, Requirements
from pipeline.scenario import FAMILIES, Scenario, draw

SEED = 0
BETWEEN = 8
"""Parts of an interval at whose ends a loss between nodes is looked at."""


def main(
    out: Annotated[Path, typer.Option(help="Folder for adrift.json.")] = Path("reports/bench"),
    count: Annotated[int, typer.Option(help="Scenarios of ten craft, of each family.")] = 50,
    large: Annotated[int, typer.Option(help="Scenarios of thirty craft.")] = 10,
    orbits: Annotated[float, typer.Option(help="Of drift.")] = 1.0,
    split: Annotated[str, typer.Option(help="Of the scenarios.")] = "valid",
) -> None:
    """Run all and print a table."""
    sizes = [(family, 10, count) for family in FAMILIES] + [("rings", 30, large)]
    with threadpool_limits(1):
        rows = [
            _line([draw(family, SEED, n, k, Problem(), split) for k in range(many)], orbits)
            for family, n, many in sizes
            if many
        ]
    show(f"Passive safety over {orbits:g} orbits", rows)
    write_json(out / "adrift.json", rows)


def _line(scenarios: list[Scenario], orbits: float) -> Row:
    """One line of the table."""
    safe = Requirements(passive_safety=orbits)
    solve(scenarios[0], requirements=safe)  # what is made once is no part of the time
    radius = scenarios[0].problem.collision_radius
    statuses, unasked, between = [], 0, []
    costs, seconds, rounds = [], [], []
    for scenario in scenarios:
        plain = solve(scenario)
        unasked += plain.status == SOLVED and _least(plain, scenario, orbits) > radius
        started = process_time()
        plan = solve(scenario, requirements=safe)
        taken = process_time() - started
        statuses.append(plan.status)
        if plan.status == SOLVED:
            costs.append(plan.certificate.fuel / plain.certificate.fuel - 1)
            seconds.append(taken)
            rounds.append(plan.convex_solves)
            between.append(_least(plan, scenario, orbits, BETWEEN))
    forbidden = statuses.count(INFEASIBLE)
    return {
        "family": scenarios[0].family,
        "n": scenarios[0].n,
        "scenarios": len(scenarios),
        "unasked": int(unasked),
        "forbidden": forbidden,
        "solved": len(costs),
        "not_solved": len(scenarios) - len(costs) - forbidden,
        "fuel_median": _of(np.median, costs),
        "fuel_mean": _of(np.mean, costs),
        "fuel_most": _of(np.max, costs),
        "rounds": _of(np.mean, rounds),
        "ms": 1e3 * _of(np.mean, seconds),
        "between": sum(least > radius for least in between),
        "between_m": _of(np.median, between),
    }


def _of(statistic: Callable[[Sequence[float]], Any], values: Sequence[float]) -> float:
    return float(statistic(values)) if values else np.nan


def _least(plan: Plan, scenario: Scenario, orbits: float, parts: int = 1) -> float:
    """Bound on the least separation after a loss, m, at nodes or so often in every interval."""
    problem = scenario.problem
    step, nodes = problem.time_step / parts, 1 + parts * problem.intervals
    finer = replace(problem, time_step=step, nodes=nodes)
    controls = np.repeat(plan.controls, parts, axis=1)
    states = fly(scenario.initial, controls, finer)
    return least_after_loss(states, controls, finer, orbits, side_by_side((scenario.n,)))[0].bound


if __name__ == "__main__":
    typer.run(main)
