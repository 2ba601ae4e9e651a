"""Figures of the packaged refiner's card: its plans on test scenarios, alone and after one solve.

    python -m benchmarks.card --out reports/bench

Prints two tables, and writes card.json: the reference problem, and other time grids beside the
expert on validation scenarios.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.progress import track

from benchmarks.tables import Row, quality, show, write_json
from pipeline.expert import Settings, solve_many
from pipeline.networks.model import load
from pipeline.networks.refiner.packaged import packaged
from pipeline.orbit.problem import Problem
from pipeline.plan import SOLVED, Plan
from pipeline.planners.network import ONE_SOLVE, NetworkPlanner
from pipeline.scenario import Scenario, draw

COUNTS = (("rings", 10, 1000), ("rings", 30, 200), ("rings", 100, 50), ("dense", 10, 300))
"""Family, swarm size and number of test scenarios."""

GRIDS = [replace(Problem(), nodes=T) for T in (6, 8, 11, 16, 21)]
GRIDS += [replace(Problem(), time_step=step) for step in (60.0, 90.0, 180.0, 240.0)]
"""Other time grids."""

TOGETHER = 50
"""Scenarios that are planned together."""


def main(
    out: Annotated[Path, typer.Option(help="Folder for card.json.")] = Path("reports/bench"),
    model: Annotated[
        Path | None, typer.Option(help="Folder of a refiner; the packaged one by default.")
    ] = None,
) -> None:
    """Plan all and print the tables."""
    flown = NetworkPlanner(packaged() if model is None else load(model), "refiner")
    rows = [_reference(flown, *count) for count in track(COUNTS, "test scenarios")]
    grids = [_grid(flown, grid) for grid in track(GRIDS, "other time grids")]
    show("Test scenarios of the reference problem", rows)
    show("100 validation scenarios of other time grids, n = 10", grids)
    write_json(out / "card.json", {"reference": rows, "grids": grids})


def _reference(flown: NetworkPlanner, family: str, n: int, count: int) -> Row:
    """The network alone, one solve after it whether it was safe or not, and the expert."""
    scenarios = [draw(family, 0, n, k, Problem(), "test") for k in range(count)]
    plans = _in_parts(flown, scenarios)
    after = solve_many(scenarios, [plan.states for plan in plans], ONE_SOLVE)
    expert = solve_many(scenarios, settings=Settings())
    safe = [plan for plan in after if plan.status == SOLVED]
    over = [
        mine.certificate.fuel / theirs.certificate.fuel
        for mine, theirs in zip(plans, expert, strict=True)
        if mine.status == theirs.status == SOLVED
    ]
    return {
        "family": family,
        "n": n,
        "scenarios": count,
        **quality(plans),
        "fuel/expert": f"{np.mean(over):.4f}",
        "safe_after_one_solve": len(safe),
        "gap_then_%": 100 * float(np.mean([plan.certificate.optimality_gap for plan in safe])),
    }


def _grid(flown: NetworkPlanner, problem: Problem) -> Row:
    """The network alone beside the expert."""
    scenarios = [draw("rings", 0, 10, k, problem, "valid") for k in range(100)]
    plans, expert = _in_parts(flown, scenarios), solve_many(scenarios, settings=Settings())
    return {
        "T": problem.nodes,
        "time_step_s": problem.time_step,
        **quality(plans),
        "expert": quality(expert)["fuel/bound"],
    }


def _in_parts(flown: NetworkPlanner, scenarios: Sequence[Scenario]) -> list[Plan]:
    parts = range(0, len(scenarios), TOGETHER)
    return [plan for k in parts for plan in flown.plan(scenarios[k : k + TOGETHER])]


if __name__ == "__main__":
    typer.run(main)
