"""How fast the expert is: beside its peers, with n, on other grids, in dense swarms, in batches.

    python -m benchmarks.expert --out reports/bench

Planners take turns on each instance, so that the machine's noise falls on all alike; times are
CPU times of one core. Prints tables, and writes expert.json.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from time import process_time
from typing import Annotated, Any

import numpy as np
import typer
from threadpoolctl import threadpool_limits

from benchmarks.peers import by_dccp
from benchmarks.tables import Row, quartiles, show, write_json
from pipeline.expert import BEST, FIRST_SAFE, Settings, solve, solve_many
from pipeline.expert.plain import PlainScp
from pipeline.expert.seeds import decoupled_seed
from pipeline.orbit.problem import Problem
from pipeline.plan import SOLVED, Requirements, Separation
from pipeline.scenario import Scenario, draw

SEED = 2022
GROWTH = {2: 60, 5: 60, 10: 60, 20: 40, 30: 40, 60: 20, 100: 12, 200: 6, 300: 6, 1000: 1}
"""Instances by swarm size; above 30 craft the rings grow, so that the density stays."""

FITTED_FROM = 30  # swarm size from which the exponent of growth is fitted
BATCHES = {10: 250, 30: 40, 100: 8}  # instances by swarm size that are planned together
CROWDS = {10: 40, 20: 10, 30: 10, 80: 4}  # instances of the family dense by swarm size

MANY_STARTS, SEARCHED = 32, 30
"""Searches that show what further ones could still win, for swarms of at most so many craft."""

DEFAULT = Settings()
NODES = (6, 11, 21, 41, 61)
ORBITS = (0.25, 0.5, 1.0, 2.0)

Work = Callable[[Any], object]


def main(
    out: Annotated[Path, typer.Option(help="Folder for expert.json.")] = Path("reports/bench"),
    instances: Annotated[int, typer.Option(help="Instances for the ratios.")] = 20,
    dccp: Annotated[int, typer.Option(help="Instances that DCCP solves.")] = 3,
) -> None:
    """Run all and print tables."""
    with threadpool_limits(1):
        ratios = _ratios(10, instances, dccp) + _ratios(30, max(3, instances // 4), 0)
        show("Time of each peer over the expert's", ratios)
        growth = [_measured(_drawn(n, k), {"n": n}) for n, k in GROWTH.items()]
        large = [(n, row["mean_ms"]) for n, row in zip(GROWTH, growth, strict=True)]
        exponent = _exponent([one for one in large if one[0] >= FITTED_FROM])
        show(f"Growth with n: time ~ n^{exponent:.2f} from n = {FITTED_FROM}", growth)
        grids = _grids()
        show("n = 10 on other grids and durations", grids)
        batches = [_batch(n, count) for n, count in BATCHES.items()]
        show("Alone and in a batch", batches)
        crowds = [row for n, count in CROWDS.items() for row in _crowd(n, count)]
        show("Dense swarms", crowds)
    result = {"ratios": ratios, "growth": growth, "exponent": exponent, "grids": grids}
    result |= {"batches": batches, "crowds": crowds}
    write_json(out / "expert.json", result)


def _drawn(
    n: int, count: int, family: str = "rings", problem: Problem | None = None
) -> list[Scenario]:
    return [draw(family, SEED, n, index, problem or Problem()) for index in range(count)]


def _ratios(n: int, instances: int, dccp: int) -> list[Row]:
    """Time of each peer over the expert's at all times and, as peers plan, at the nodes only."""
    plain = PlainScp(n, Problem())

    def by_plain(scenario: Scenario) -> object:  # from where the expert starts too
        return plain.solve(scenario, decoupled_seed(scenario))

    peers: list[tuple[str, Separation, int, Work]] = [
        ("plain SCP", "continuous", instances, by_plain),
        ("plain SCP", "nodes", instances, by_plain),
        ("DCCP", "continuous", dccp, by_dccp),
    ]
    return [_ratio(n, *peer) for peer in peers if peer[2]]


def _ratio(n: int, name: str, separation: Separation, count: int, peer: Work) -> Row:
    expert = partial(solve, requirements=Requirements(separation))
    pairs = [(_time(peer, one), _time(expert, one)) for one in _drawn(n, count)]
    theirs, ours = np.array(pairs).T
    return {
        "peer": name,
        "n": n,
        "expert": separation,
        "instances": count,
        "peer_ms": 1e3 * float(theirs.mean()),
        "expert_ms": 1e3 * float(ours.mean()),
        "ratio_of_means": float(theirs.mean() / ours.mean()),
        "median_ratio": float(np.median(theirs / ours)),
        "quartiles": quartiles(theirs / ours),
    }


def _exponent(times: Sequence[tuple[Any, Any]]) -> float:
    n, mean = np.log(np.array(times, dtype=float)).T
    return float(np.polyfit(n, mean, 1)[0])


def _grids() -> list[Row]:
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


def _batch(n: int, count: int) -> Row:
    scenarios = _drawn(n, count)
    solve_many(scenarios)
    row: Row = {"n": n, "instances": count}
    for name, settings in (("", DEFAULT), ("first_safe_", FIRST_SAFE)):
        alone = sum(_time(partial(solve, settings=settings), one) for one in scenarios)
        together = _time(partial(solve_many, settings=settings), scenarios)
        row |= {f"{name}ms": 1e3 * alone / count, f"{name}batch_ms": 1e3 * together / count}
    return row


def _crowd(n: int, count: int) -> list[Row]:
    scenarios = _drawn(n, count, "dense")
    size = np.mean([np.abs(s.initial[:, :3]).max() for s in scenarios])
    head: Row = {"n": n, "half_extent_m": float(size)}
    efforts = {"default": DEFAULT, "best": BEST}
    if n <= SEARCHED:
        efforts[f"{MANY_STARTS} starts"] = replace(BEST, starts=MANY_STARTS)
    return [
        _measured(scenarios, {**head, "effort": name}, settings)
        for name, settings in efforts.items()
    ]


def _measured(scenarios: Sequence[Scenario], head: Row, settings: Settings = DEFAULT) -> Row:
    """Time and quality of the expert on some instances, and the most memory so far."""
    solve(scenarios[0])
    count, work = len(scenarios), partial(solve, settings=settings)
    times = np.array([_time(work, s) for s in scenarios]) * 1e3
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


def _time(work: Work, what: Any) -> float:
    started = process_time()
    work(what)
    return process_time() - started


if __name__ == "__main__":
    typer.run(main)
