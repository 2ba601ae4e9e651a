"""How fast the expert is: ratios to its peers, growth with n, other grids and durations.

    python -m benchmarks.expert --out reports/bench

Planners take turns on each instance, so that the machine's noise falls on all alike; times are
CPU times of one core. Prints tables, and writes expert.json and growth.svg.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from time import process_time
from typing import Annotated, Literal

import numpy as np
import typer
from matplotlib.figure import Figure
from threadpoolctl import threadpool_limits

from benchmarks.peers import solve_dccp
from benchmarks.tables import Row, quartiles, show, write_json
from pipeline.exhibits.style import PAGE_WIDTH, save
from pipeline.expert import Settings, own_optima, solve
from pipeline.expert.plain import PlainScp
from pipeline.expert.seeds import own_seed
from pipeline.orbit.problem import Problem
from pipeline.plan import SOLVED
from pipeline.scenario import Scenario, draw

SEED = 2022
GROWTH = {2: 60, 5: 60, 10: 60, 20: 40, 30: 40, 60: 20, 100: 12, 200: 6, 300: 6}
"""Instances by swarm size; above 30 craft the rings grow, so that the density stays."""

FITTED_FROM = 30
NODES = (6, 11, 21, 41, 61)
ORBITS = (0.25, 0.5, 1.0, 2.0)

Work = Callable[[Scenario], object]


def main(
    out: Annotated[Path, typer.Option(help="Folder for expert.json and growth.svg.")] = Path(
        "reports/bench"
    ),
    instances: Annotated[int, typer.Option(help="Instances for the ratios.")] = 20,
    dccp: Annotated[int, typer.Option(help="Instances that DCCP solves.")] = 3,
) -> None:
    """Run all and print tables."""
    with threadpool_limits(1):
        ratios = _ratios(10, instances, dccp) + _ratios(30, max(3, instances // 4), 0)
        show("Time of each peer over the expert's", ratios)
        growth, exponent = _growth()
        show(f"Growth with n: time ~ n^{exponent:.2f} from n = {FITTED_FROM}", growth)
        grids = _grids()
        show("n = 10 on other grids and durations", grids)
    result = {"ratios": ratios, "growth": growth, "exponent": exponent, "grids": grids}
    write_json(out / "expert.json", result)
    save(_figure(growth, exponent), out / "growth")


def _ratios(n: int, instances: int, dccp: int) -> list[Row]:
    """Each peer's time over the expert's, on the same instances in turn.

    The peers keep craft apart at the nodes; so they stand beside the expert both as it works by
    default, at all times, and at the nodes.
    """
    plain = PlainScp(n, Problem())

    def by_plain(scenario: Scenario) -> object:  # from the own LPs, where the expert starts too
        return plain.solve(scenario, own_seed(scenario))

    peers: list[tuple[str, str, int, Work]] = [
        ("own LP of each craft", "continuous", instances, _own),
        ("the same SCP in cvxpy", "continuous", instances, by_plain),
        ("the same SCP in cvxpy", "nodes", instances, by_plain),
    ]
    if dccp:
        peers.append(("DCCP", "continuous", dccp, solve_dccp))
    return [_ratio(n, *peer) for peer in peers]


def _own(scenario: Scenario) -> object:
    return own_optima(scenario.initial, scenario.goal, scenario.problem)


def _ratio(
    n: int, name: str, separation: Literal["continuous", "nodes"], count: int, peer: Work
) -> Row:
    settings = Settings(separation=separation)
    pairs = []
    for index in range(count):
        scenario = draw("rings", SEED, n, index, Problem())
        expert = _time(lambda s: solve(s, settings=settings), scenario)
        pairs.append((_time(peer, scenario), expert))
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


def _growth() -> tuple[list[Row], float]:
    rows = [_sample(n, count, Problem(), {"n": n}) for n, count in GROWTH.items()]
    large = [(row["n"], row["mean_ms"]) for row in rows if row["n"] >= FITTED_FROM]  # type: ignore[operator]
    n, mean = np.log(np.array(large, dtype=float)).T
    return rows, float(np.polyfit(n, mean, 1)[0])


def _grids() -> list[Row]:
    reference = Problem()
    rows = [
        _sample(10, 20, Problem(nodes=T, time_step=1200 / (T - 1)), {"T": T, "orbits": ""})
        for T in NODES
    ]
    period = 2 * np.pi / reference.mean_motion
    for orbits in ORBITS:
        problem = Problem(time_step=orbits * period / reference.intervals)
        rows.append(_sample(10, 20, problem, {"T": problem.nodes, "orbits": orbits}))
    return rows


def _sample(n: int, count: int, problem: Problem, head: Row) -> Row:
    """Time and quality of the expert on some instances."""
    scenarios = [draw("rings", SEED, n, index, problem) for index in range(count)]
    solve(scenarios[0])
    times = np.array([_time(solve, s) for s in scenarios]) * 1e3
    plans = [solve(s) for s in scenarios]
    return {
        **head,
        "instances": count,
        "mean_ms": float(times.mean()),
        "median_ms": float(np.median(times)),
        "quartiles": quartiles(times),
        "gap_percent": 100 * float(np.mean([p.certificate.optimality_gap for p in plans])),
        "convex_solves": float(np.mean([p.convex_solves for p in plans])),
        "safe": f"{sum(p.status == SOLVED for p in plans)}/{count}",
    }


def _time(work: Work, scenario: Scenario) -> float:
    started = process_time()
    work(scenario)
    return process_time() - started


def _figure(rows: Sequence[Row], exponent: float) -> Figure:
    n = np.array([row["n"] for row in rows], dtype=float)
    mean = np.array([row["mean_ms"] for row in rows], dtype=float)
    fitted = n >= FITTED_FROM
    level = np.exp(np.mean(np.log(mean[fitted]) - exponent * np.log(n[fitted])))
    figure = Figure(figsize=(PAGE_WIDTH / 2, 3), layout="constrained")
    axes = figure.add_subplot(xscale="log", yscale="log")
    axes.plot(n, mean, "o", color="black", label="expert, mean")
    line = level * n[fitted] ** exponent
    axes.plot(n[fitted], line, "--", color="#0072B2", label=f"n^{exponent:.2f}")
    axes.set_xticks(n[::2], [f"{k:.0f}" for k in n[::2]])
    axes.minorticks_off()
    axes.set_xlabel("spacecraft n")
    axes.set_ylabel("time per instance (ms)")
    axes.legend()
    return figure


if __name__ == "__main__":
    typer.run(main)
