"""Our plans beside published results, and beside the plans of other planners.

    python -m benchmarks.yardstick --page docs/yardstick.md

Cases of one craft have a published or proven Δv; swarms are planned by other planners too, each a
function from a scenario to controls. The judge is that of the tests, which shares no code with any
planner. All runs on one core; times are CPU times. Planners that are not installed are left out,
with a message that says what to install: dccp, openscvx==0.5.2, bsk==2.12.1. Those of others plan
in a process of their own, which ends after a given CPU time for each swarm.
"""

import resource
import sys
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from platform import python_version
from time import process_time
from typing import Annotated, Literal

import numpy as np
import pandas as pd
import typer
from threadpoolctl import threadpool_limits

from benchmarks.basilisk import reconfiguration
from benchmarks.peers import by_dccp, by_openscvx, by_plain_scp, by_repair
from benchmarks.rendezvous import CHIEF, STEP, optima
from benchmarks.tables import PageOption, limited_process, update_page, use_one_core
from cli.output import echo
from pipeline.errors import InputError, ProlearnError
from pipeline.expert import solve
from pipeline.orbit.arrays import Controls
from pipeline.orbit.problem import Problem
from pipeline.plan.requirements import Requirements
from pipeline.scenario import Scenario, draw
from pipeline.scenario.document import document_of, read_scenario

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tests/support"))  # the judge is no part of the package
import relative  # noqa: E402
from judge import Case as Circle  # noqa: E402
from judge import closest_approaches, fly, least_fuel  # noqa: E402
from judge.corridors import inside  # noqa: E402
from judge.keep_out import outside  # noqa: E402
from koenig import transition  # noqa: E402

MARK = "<!-- made by python -m benchmarks.yardstick -->"
PACKAGES = ("clarabel", "highspy", "cvxpy", "dccp", "openscvx", "bsk")
SEED = 2022
MISS, SPEED = 1e-2, 1e-5  # largest errors at a goal that the judge accepts, m and m/s
SWARMS = (("rings", 10, 10), ("dense", 10, 10), ("rings", 30, 10))  # family, n, scenarios
PATIENCE = 300.0  # CPU time that a foreign planner has for a swarm's scenarios, s
PARTS = 10  # of an arc, at whose ends obstacles and corridors are checked

PlanFunction = Callable[[Scenario], Controls]
Norm = Literal["components", "norm"]


@dataclass(frozen=True)
class BenchmarkCase:
    """A transfer of one craft, in legs, with a published or computed Δv."""

    name: str
    files: tuple[str, ...]  # in examples/, a leg each
    thrust: Norm  # components: Σ‖u‖₁; norm: Σ‖u‖₂
    theirs: Callable[[], float]  # Δv, m/s
    source: str
    why: str  # reason for the difference


@dataclass(frozen=True)
class Peer:
    """A planner of swarms, and how it works."""

    name: str
    plan: PlanFunction
    what: str
    foreign: bool = False  # plans in a process of its own, whose time is limited
    compiles: bool = False  # before some plans: not timed, but counted against that limit


@dataclass(frozen=True)
class Judgement:
    """What the judge finds of a plan."""

    arrives: bool
    fuel: float  # Σ‖u‖₁, m/s²
    at_nodes: float  # least distance of any pair there, m
    at_all_times: float

    def safe(self, radius: float) -> tuple[bool, bool]:
        """Whether the goals are met and no pair comes within a radius: at nodes, at all times."""
        return self.arrives and self.at_nodes > radius, self.arrives and self.at_all_times > radius


def damico(in_plane: float, across: float, thrust: Norm) -> float:
    """D'Amico's closed-form lower bound of the TanDEM-X-like cases, m/s.

    n‖aΔδe‖/2 along track and n‖aΔδi‖ across, added as the norm has it (D'Amico 2010; Gaias and
    D'Amico 2015, "Impulsive maneuvers for formation reconfiguration using relative orbital
    elements"); changes of the relative eccentricity and inclination vectors in m.
    """
    n = np.sqrt(398600.4418e9 / 6886536.686**3)
    parts = n * np.array([in_plane / 2, across])
    return float(np.linalg.norm(parts, 1 if thrust == "components" else 2))


def tandem_x(name: str, file: str, change: tuple[float, float]) -> list[BenchmarkCase]:
    """The cases of a change (in plane, across), m, one in either norm."""
    whys: dict[Norm, str] = {
        "components": "Arcs cost more, as above; and states with exactly these elements differ "
        "from the linear ones by millimetres in the plane, which costs fuel too.",
        "norm": "The same; burns in and across the plane at one time are one burn.",
    }
    return [
        BenchmarkCase(
            name, (file,), thrust, partial(damico, *change, thrust), "D'Amico's lower bound", why
        )
        for thrust, why in whys.items()
    ]


@cache
def rendezvous_optima() -> list[tuple[np.ndarray, np.ndarray]]:
    """Optima of the sequential convex programs for the rendezvous with the ISS, by ``optima``."""
    return list(optima(transition(np.array(CHIEF), STEP)))


def rendezvous() -> float:
    """Δv of the rendezvous with the ISS by sequential convex programs, m/s."""
    _, burns = rendezvous_optima()[-1]
    return float(np.linalg.norm(burns, axis=0).sum())


ARCS = "Ours are arcs of constant acceleration, which cost more than impulses"
CASES = (
    BenchmarkCase(
        "SIMBOL-X",
        ("simbol-x",),
        "components",
        lambda: 1.7913,
        "Arzelier and others 2011",
        f"{ARCS}: 1,200 of them cost 0.09 % more here.",
    ),
    BenchmarkCase(
        "SIMBOL-X",
        ("simbol-x",),
        "norm",
        lambda: 1.3211,
        "Benedikter and others 2019",
        f"{ARCS}: 1,200 of them cost 0.08 % more here.",
    ),
    *tandem_x("TanDEM-X-like, δi", "tandem-x-plane", (0.0, 100.0)),
    *tandem_x("TanDEM-X-like, δe and δi", "tandem-x-both", (200.0, 200.0)),
    BenchmarkCase(
        "Basilisk's reconfiguration",
        ("basilisk-reconfiguration",),
        "norm",
        lambda: reconfiguration()[0],
        "bsk 2.12.1, run here",
        "Theirs are three burns by a closed form, one for each pair of elements; ours have the "
        "least fuel for the same states and time.",
    ),
    BenchmarkCase(
        "Rendezvous with the ISS",
        ("station-approach", "station-docking"),
        "norm",
        rendezvous,
        "Transformer-MPC's SCP, run here",
        "Ours are arcs of 113 s, theirs impulses: the last 30 m, in nine arcs, cost 13 % more; and "
        "our path around the station is a local optimum.",
    ),
)

PEERS = (
    Peer("expert", lambda s: solve(s).controls, "this project, apart at all times"),
    Peer(
        "expert, at nodes",
        lambda s: solve(s, requirements=Requirements("nodes")).controls,
        "this project, apart at the nodes only, like the next two",
    ),
    Peer("plain SCP", by_plain_scp, "the paper's kind: every pair at every node, one program"),
    Peer("DCCP", by_dccp, "cvxpy's convex-concave procedure, apart at the nodes", foreign=True),
    Peer(
        "OpenSCvx",
        by_openscvx,
        "0.5.2, without `solve_batched`, default settings: `ctcs` constraints, from decoupled "
        "optima; compiled before",
        foreign=True,
        compiles=True,
    ),
    Peer(
        "decoupled, repaired",
        by_repair,
        "HiGHS for each craft; one that meets another of lower number is replanned around all",
    ),
)


def flown(scenario: Scenario, controls: Controls) -> np.ndarray:
    """States by the judge, (n, T, 6): at the nodes, and under J2 also between them."""
    orbit, step = scenario.problem.orbit, scenario.problem.time_step
    if orbit is None:
        return fly(Circle.of(document_of(scenario)), scenario.initial, controls)
    shape = orbit.semi_major_axis, orbit.eccentricity
    names = ("inclination", "raan", "argument_of_perigee", "argument_of_latitude")
    angles = np.radians([getattr(orbit, f"{name}_deg") for name in names])
    if orbit.j2:
        grid, force = (step, scenario.problem.intervals, PARTS), partial(relative.pull, j2=True)
        fly_on = relative.linear_flight(relative.state_of(*shape, angles), *grid, force)
        return fly_on(scenario.initial, controls).reshape(scenario.n, -1, 6)
    since = step * np.arange(scenario.problem.intervals)
    begins, states = relative.true_anomaly(*shape, angles[3] - angles[2], since), [scenario.initial]
    for k, free in enumerate(relative.yamanaka_ankersen(*shape, begins, step)):
        states.append(states[-1] @ free.T)
        if controls[:, k].any():
            states[-1] = states[-1] + controls[:, k] @ relative.forced(*shape, begins[k], step).T
    return np.stack(states, axis=1)


def clearance(scenario: Scenario, states: np.ndarray) -> float:
    """Least distance of positions to ellipsoids about the origin and to corridors' edges, m."""
    asked, places = document_of(scenario), states[..., :3].reshape(-1, 3)
    ellipsoids = [np.array(one["semi_axes"]) for one in asked.get("obstacles", [])]
    apart = [float(outside(places, axes).min()) for axes in ellipsoids]
    within = [float(inside(places, one).min()) for one in asked.get("corridors", [])]
    return min([np.inf, *apart, *within])


def judged(scenario: Scenario, controls: Controls) -> Judgement:
    """The judge's verdict on controls; distances in swarms only about circular orbits."""
    states = flown(scenario, controls)
    miss = np.abs(states[:, -1] - scenario.goal)
    arrives = bool(miss[:, :3].max() <= MISS and miss[:, 3:].max() <= SPEED)
    nodes = always = clearance(scenario, states) if scenario.n == 1 else np.inf
    if scenario.n > 1:
        found = closest_approaches(Circle.of(document_of(scenario)), states, controls)
        pairs = states[found.first] - states[found.second]
        nodes, always = np.linalg.norm(pairs[..., :3], axis=2).min(), found.low.min()
    return Judgement(arrives, float(np.abs(controls).sum()), float(nodes), float(always))


def cost(scenario: Scenario) -> float:
    """Δv of our plan, m/s, by the scenario's thrust; ProlearnError where the judge refuses it."""
    problem, controls = scenario.problem, solve(scenario).controls
    if not judged(scenario, controls).safe(0.0)[1]:
        raise ProlearnError(
            f"the plan of {scenario.name} misses its goal by the judge, or comes where it must not."
        )
    order = 1 if problem.thrust.model == "components" else 2
    return problem.time_step * float(np.linalg.norm(controls, order, axis=2).sum())


def case_row(case: BenchmarkCase) -> dict[str, object]:
    """Table row of a benchmark case: our Δv beside the published one."""
    ours, theirs = 0.0, case.theirs()
    for file in case.files:
        scenario = read_scenario(ROOT / f"examples/{file}.json")
        thrust = replace(scenario.problem.thrust, model=case.thrust)
        ours += cost(replace(scenario, problem=replace(scenario.problem, thrust=thrust)))
    return {
        "case": case.name,
        "file": ", ".join(f"`{file}.json`" for file in case.files),
        "norm": 1 if case.thrust == "components" else 2,
        "ours, m/s": f"{ours:.4f}",
        "theirs, m/s": f"{theirs:.4f}",
        "ratio": f"{ours / theirs:.4f}",
        "whose": case.source,
        "why they differ": case.why,
    }


class PeerPlanning:
    """A peer planning a swarm's scenarios; a foreign one does so in a process with a time limit."""

    def __init__(self, peer: Peer, patience: float) -> None:
        self.peer, self.made = peer, list[tuple[Judgement, float]]()
        self.over: float | None = None  # CPU time after which the process ended, s
        self._pool = limited_process(patience) if peer.foreign else None

    def plan(self, scenario: Scenario) -> None:
        """Have a scenario planned and judged, unless the process has ended."""
        if self.over is not None:
            return
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        if self._pool is None:
            controls, seconds = _planned(self.peer, scenario)
        else:
            try:
                controls, seconds = self._pool.submit(_planned, self.peer, scenario).result()
            except BrokenProcessPool:
                self._pool.shutdown()
                after = resource.getrusage(resource.RUSAGE_CHILDREN)
                self.over = sum(after[:2]) - sum(before[:2])
                return
        none = Judgement(False, np.nan, 0.0, 0.0)
        self.made.append((none if controls is None else judged(scenario, controls), seconds))


def _planned(peer: Peer, scenario: Scenario) -> tuple[Controls | None, float]:
    """Controls, or None where the peer finds none, and the CPU time that it takes, s."""
    if peer.compiles:
        peer.plan(scenario)
    started, controls = process_time(), None
    try:
        controls = peer.plan(scenario)
    except InputError:
        raise
    except ProlearnError as error:  # there is no plan
        echo(f"{scenario.name}: {error}")
    return controls, process_time() - started


def swarm_rows(
    swarm: tuple[str, int, int], peers: Sequence[Peer] = PEERS, patience: float = PATIENCE
) -> list[dict[str, object]]:
    """A row for each peer, ours first, on some scenarios of a family and n; patience in s."""
    family, n, count = swarm
    scenarios = [draw(family, SEED, n, k, Problem()) for k in range(count)]
    bounds = [
        least_fuel(Circle.of(document_of(s)), s.initial, s.goal).attained.sum() for s in scenarios
    ]
    planning = [PeerPlanning(peer, patience) for peer in peers]
    solve(scenarios[0])  # what is imported or tabled once is not counted
    for scenario in scenarios:
        for one in list(planning):
            try:
                one.plan(scenario)
            except InputError as missing:
                echo(f"{one.peer.name} is left out: {missing}")
                planning.remove(one)
    return [
        {"swarm": f"{family}, {n}", "planner": one.peer.name}
        | _figures(one, planning[0], np.array(bounds))
        | {"how": one.peer.what}
        for one in planning
    ]


def _figures(one: PeerPlanning, ours: PeerPlanning, least: np.ndarray) -> dict[str, object]:
    """Columns of a row, on the scenarios planned before the process ended, beside ours on these."""
    few = len(one.made)
    safe = [verdict.safe(Problem().collision_radius) for verdict, _ in one.made]
    (fuel, seconds), (our_fuel, our_seconds) = (
        np.array([(verdict.fuel, taken) for verdict, taken in some.made[:few]]).reshape(few, 2).T
        for some in (one, ours)
    )
    time = _spread(seconds, ".3g") + ", then ended" * (one.over is not None)
    return {
        "safe at nodes": f"{sum(at for at, _ in safe)} of {few}",
        "safe at all times": f"{sum(at for _, at in safe)} of {few}",
        "fuel / least": _spread(fuel / least[:few], ".4f"),
        "fuel / ours": _spread(fuel / our_fuel, ".4f"),
        "time, s": time if few else f"no plan in {one.over:.0f} s",
        "time / ours": _spread(seconds / our_seconds, ".3g"),
    }


def _spread(values: np.ndarray, digits: str) -> str:
    """Median of the finite values, with the range if there are several, as text."""
    found = values[np.isfinite(values)]
    if len(found) == 0:
        return ""
    middle, low, high = (f"{x:{digits}}" for x in (np.median(found), found.min(), found.max()))
    return middle if low == high else f"{middle} ({low} to {high})"


def _versions() -> str:
    found = [f"Python {python_version()}"]
    for package in PACKAGES:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            continue
    return "One core; CPU times; " + ", ".join(found) + "."


def main(
    page: PageOption = None,
    patience: Annotated[
        float,
        typer.Option(min=1, help="CPU time of a foreign planner for a swarm, s."),
    ] = PATIENCE,
) -> None:
    """Run all that is installed and print the tables."""
    use_one_core()
    cases = []
    with threadpool_limits(1):
        for case in CASES:
            try:
                cases.append(case_row(case))
            except InputError as missing:
                echo(f"{case.name} is left out: {missing}")
        swarms = [row for swarm in SWARMS for row in swarm_rows(swarm, patience=patience)]
    tables = [pd.DataFrame(rows).to_markdown(index=False) for rows in (cases, swarms)]
    update_page(page, MARK, "\n\n".join([*tables, _versions()]))


if __name__ == "__main__":
    typer.run(main)
