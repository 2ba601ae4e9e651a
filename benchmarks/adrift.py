"""What safety after a loss of thrust costs, and how many plans have it without asking.

    python -m benchmarks.adrift --out reports/bench

Plans scenarios of every family twice, without and with passive safety, and prints a line for each:
how many plans have it unasked, for how many scenarios the two ends alone forbid it, how many are
solved, what it costs in fuel, how many rounds of programs and how long it takes, certificate
included, and how many plans also stand a loss between nodes. Writes adrift.json.
"""

from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Annotated

import numpy as np
import typer
from threadpoolctl import threadpool_limits

from benchmarks.tables import Row, show, write_json
from pipeline.expert import Settings, solve
from pipeline.orbit.approaches import side_by_side
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust_loss import least_after_loss
from pipeline.orbit.transfer import fly
from pipeline.plan import INFEASIBLE, SOLVED, Plan
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
            _line(
                family, n, [draw(family, SEED, n, k, Problem(), split) for k in range(many)], orbits
            )
            for family, n, many in sizes
            if many
        ]
    show(f"Passive safety over {orbits:g} orbits", rows)
    write_json(out / "adrift.json", rows)


def _line(scenarios: list[Scenario], orbits: float) -> Row:
    """One line of the table."""
    settings = Settings(passive_safety=orbits)
    solve(scenarios[0], settings=settings)  # what is made once is no part of the time
    unasked, costs, seconds, rounds, between = 0, [], [], [], 0
    statuses = []
    for scenario in scenarios:
        plain = solve(scenario)
        unasked += plain.status == SOLVED and _stands(plain, scenario, orbits)
        started = process_time()
        plan = solve(scenario, settings=settings)
        taken = process_time() - started
        statuses.append(plan.status)
        if plan.status == SOLVED:
            costs.append(plan.certificate.fuel / plain.certificate.fuel - 1)
            seconds.append(taken)
            rounds.append(plan.convex_solves)
            between += _stands(plan, scenario, orbits, BETWEEN)
    return {
        "family": scenarios[0].family,
        "n": scenarios[0].n,
        "scenarios": len(scenarios),
        "unasked": int(unasked),
        "forbidden": statuses.count(INFEASIBLE),
        "solved": len(costs),
        "not_solved": len(scenarios) - len(costs) - statuses.count(INFEASIBLE),
        "fuel_median": float(np.median(costs)) if costs else np.nan,
        "fuel_mean": float(np.mean(costs)) if costs else np.nan,
        "fuel_most": float(np.max(costs)) if costs else np.nan,
        "rounds": float(np.mean(rounds)) if rounds else np.nan,
        "ms": 1e3 * float(np.mean(seconds)) if seconds else np.nan,
        "between": between,
    }


def _stands(plan: Plan, scenario: Scenario, orbits: float, parts: int = 1) -> bool:
    """Whether a plan has passive safety, also where thrust is lost so often in every interval."""
    problem = scenario.problem
    finer = replace(
        problem, time_step=problem.time_step / parts, nodes=1 + parts * problem.intervals
    )
    controls = np.repeat(plan.controls, parts, axis=1)
    states = fly(scenario.initial, controls, finer)
    least = least_after_loss(states, controls, finer, orbits, side_by_side((scenario.n,)))[0]
    return least is None or least.bound > problem.collision_radius


if __name__ == "__main__":
    typer.run(main)
