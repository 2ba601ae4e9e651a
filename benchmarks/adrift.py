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
from typing import Annotated

import numpy as np
import pandas as pd
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
    every = [draw(family, SEED, n, k, Problem(), split) for family, n, m in sizes for k in range(m)]
    with threadpool_limits(1):
        solve(every[0], requirements=Requirements(passive_safety=orbits))  # makes what is made once
        trials = pd.DataFrame([_trial(scenario, orbits) for scenario in every])
    rows = trials.groupby(["family", "n"], sort=False).agg(
        scenarios=("solved", "size"),
        unasked=("unasked", "sum"),
        forbidden=("forbidden", "sum"),
        solved=("solved", "sum"),
        fuel_median=("fuel", "median"),
        fuel_mean=("fuel", "mean"),
        fuel_most=("fuel", "max"),
        rounds=("rounds", "mean"),
        ms=("ms", "mean"),
        between=("between", "sum"),
        between_m=("between_m", "median"),
    )
    lines = rows.reset_index().to_dict("records")
    show(f"Passive safety over {orbits:g} orbits", lines)
    write_json(out / "adrift.json", lines)


def _trial(scenario: Scenario, orbits: float) -> Row:
    """One scenario planned without and with passive safety; numbers of the latter if solved."""
    plain, radius = solve(scenario), scenario.problem.collision_radius
    started = process_time()
    plan = solve(scenario, requirements=Requirements(passive_safety=orbits))
    taken = process_time() - started
    row: Row = {
        "family": scenario.family,
        "n": scenario.n,
        "unasked": plain.status == SOLVED and _least(plain, scenario, orbits) > radius,
        "forbidden": plan.status == INFEASIBLE,
        "solved": plan.status == SOLVED,
        "between": False,
    }
    if plan.status == SOLVED:
        row["fuel"] = plan.certificate.fuel / plain.certificate.fuel - 1
        row["rounds"], row["ms"] = plan.convex_solves, 1e3 * taken
        row["between_m"] = apart = _least(plan, scenario, orbits, BETWEEN)
        row["between"] = apart > radius
    return row


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
