"""Cost of passive safety in fuel and time, and how many plans are passively safe unasked.

    python -m benchmarks.adrift --out reports/bench

Plans scenarios of every family without and with passive safety. A line for each has how many plans
are passively safe unasked, for how many scenarios the two ends alone forbid it, how many are
solved, the cost in fuel, rounds of programs, time with the certificate, how many plans also stand a
loss between nodes, and how close craft come after one (median, m). docs/passive-safety.md has what
came of it.
"""

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
    safe, radius = Requirements(passive_safety=orbits), scenarios[0].problem.collision_radius
    solve(scenarios[0], requirements=safe)  # what is made once is no part of the time
    unasked = forbidden = 0
    solved: list[tuple[float, ...]] = []  # cost in fuel, seconds, rounds, separation between nodes
    for scenario in scenarios:
        plain = solve(scenario)
        unasked += plain.status == SOLVED and _least(plain, scenario, orbits) > radius
        started = process_time()
        plan = solve(scenario, requirements=safe)
        taken = process_time() - started
        forbidden += plan.status == INFEASIBLE
        if plan.status == SOLVED:
            cost = plan.certificate.fuel / plain.certificate.fuel - 1
            between = _least(plan, scenario, orbits, BETWEEN)
            solved.append((cost, taken, plan.convex_solves, between))
    costs, seconds, rounds, apart = np.array(solved or [(np.nan,) * 4], dtype=float).T
    numbers: dict[str, Any] = {
        "fuel_median": np.median(costs),
        "fuel_mean": costs.mean(),
        "fuel_most": costs.max(),
        "rounds": rounds.mean(),
        "ms": 1e3 * seconds.mean(),
    }
    return {
        "family": scenarios[0].family,
        "n": scenarios[0].n,
        "scenarios": len(scenarios),
        "unasked": int(unasked),
        "forbidden": forbidden,
        "solved": len(solved),
        "not_solved": len(scenarios) - len(solved) - forbidden,
        **{name: float(value) for name, value in numbers.items()},
        "between": int((apart > radius).sum()),
        "between_m": float(np.median(apart)),
    }


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
