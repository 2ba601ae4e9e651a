"""Benchmark of the expert's run time on other time grids and for dense swarms.

    python -m benchmarks.expert --out reports/bench

Times are CPU times of one core. Prints tables, and writes expert.json. ``benchmarks.yardstick``
compares it with other planners, ``benchmarks.growth`` shows how it grows with the number of craft,
and ``benchmarks.fallback`` measures batches.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from resource import RUSAGE_SELF, getrusage
from time import process_time
from timeit import timeit

import numpy as np
import typer
from threadpoolctl import threadpool_limits

from benchmarks.tables import BENCH, OutOption, TableRow, quartiles, show, write_json
from pipeline.expert import BEST, Settings, solve, solve_many
from pipeline.orbit.problem import Problem
from pipeline.plan.plan import SOLVED
from pipeline.scenario import Scenario, draw

SEED = 2022
CROWDS = {10: 40, 20: 10, 30: 10, 80: 4}  # instances of the family dense by swarm size

MANY_STARTS, SEARCHED = 32, 30
"""Starts that show what further search could still gain, in swarms of at most so many craft."""

DEFAULT = Settings()
NODES = (6, 11, 21, 41, 61)
ORBITS = (0.25, 0.5, 1.0, 2.0)


def main(out: OutOption = BENCH) -> None:
    """Run all and print tables."""
    with threadpool_limits(1):
        grids = _grids()
        show("n = 10 on other grids and durations", grids)
        crowds = [row for n, count in CROWDS.items() for row in _crowd(n, count)]
        show("Dense swarms", crowds)
    write_json(out / "expert.json", {"grids": grids, "crowds": crowds})


def _drawn(
    n: int, count: int, family: str = "rings", problem: Problem | None = None
) -> list[Scenario]:
    return [draw(family, SEED, n, index, problem or Problem()) for index in range(count)]


def _grids() -> list[TableRow]:
    reference = Problem()
    period = 2 * np.pi / reference.mean_motion
    grids: list[tuple[Problem, float | str]] = [
        *((Problem(nodes=T, time_step=1200 / (T - 1)), "") for T in NODES),
        *((Problem(time_step=o * period / reference.intervals), o) for o in ORBITS),
    ]
    return [
        _measured(_drawn(10, 20, problem=grid), {"T": grid.nodes, "orbits": orbits})
        for grid, orbits in grids
    ]


def _crowd(n: int, count: int) -> list[TableRow]:
    scenarios = _drawn(n, count, "dense")
    size = np.mean([np.abs(s.initial[:, :3]).max() for s in scenarios])
    head: TableRow = {"n": n, "half_extent_m": float(size)}
    efforts = {"default": DEFAULT, "best": BEST}
    if n <= SEARCHED:
        efforts[f"{MANY_STARTS} starts"] = replace(BEST, starts=MANY_STARTS)
    return [
        _measured(scenarios, {**head, "effort": name}, settings)
        for name, settings in efforts.items()
    ]


def _measured(
    scenarios: Sequence[Scenario], head: TableRow, settings: Settings = DEFAULT
) -> TableRow:
    """Time and quality of the expert on some instances, and the most memory so far."""
    solve(scenarios[0])
    count, once = len(scenarios), partial(timeit, timer=process_time, number=1)
    times = np.array([once(partial(solve, s, settings=settings)) for s in scenarios]) * 1e3
    plans = solve_many(scenarios, settings=settings)
    return {
        **head,
        "instances": count,
        "mean_ms": float(times.mean()),
        "median_ms": float(np.median(times)),
        "quartiles": quartiles(times),
        "gap_percent": 100 * float(np.mean([p.certificate.optimality_gap for p in plans])),
        "convex_solves": float(np.mean([p.convex_solves for p in plans])),
        "safe": f"{sum(p.status == SOLVED for p in plans)}/{count}",
        "peak_mib": getrusage(RUSAGE_SELF).ru_maxrss / 1024,
    }


if __name__ == "__main__":
    typer.run(main)
