"""The yardstick: our plans beside what is published, and beside what others plan.

    python -m benchmarks.yardstick --page docs/yardstick.md

Cases of one craft have a published or proven figure; swarms are planned by peers too, each one
function from a scenario to controls. The judge is that of the tests, which shares no code with any
planner. All runs on one core; times are its CPU times. Peers that are not installed are left out,
and a sentence says what to install: dccp, openscvx==0.5.2, bsk==2.12.1.
"""

import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
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
from cli.output import echo
from pipeline.errors import InputError, ProlearnError
from pipeline.expert import solve
from pipeline.files import write_text
from pipeline.orbit.arrays import Controls
from pipeline.orbit.problem import Problem
from pipeline.plan import Requirements
from pipeline.scenario import Scenario, draw
from pipeline.scenario.document import document_of, read_scenario
from pipeline.scenario.scenario import MOST_CRAFT

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tests/support"))  # the judge is no part of the package
from judge import Case as Circle  # noqa: E402
from judge import closest_approaches, fly, least_fuel  # noqa: E402
from relative import forced, true_anomaly, yamanaka_ankersen  # noqa: E402

MARK = "<!-- made by python -m benchmarks.yardstick -->"
PACKAGES = ("clarabel", "highspy", "cvxpy", "dccp", "openscvx", "bsk")
SEED = 2022
MISS, SPEED = 1e-2, 1e-5  # of a goal, m and m/s, that the judge lets pass
SWARMS = (("rings", 10, 3), ("dense", 10, 3), ("rings", 30, 3))  # family, n, scenarios

Planner = Callable[[Scenario], Controls]
Norm = Literal["components", "norm"]


@dataclass(frozen=True)
class Case:
    """A transfer of one craft, and what somebody else says that it costs."""

    name: str
    file: str  # in examples/
    thrust: Norm  # components: Σ‖u‖₁; norm: Σ‖u‖₂
    theirs: Callable[[], float]  # Δv, m/s
    source: str
    why: str  # in what way ours is not theirs


@dataclass(frozen=True)
class Peer:
    """A planner of swarms, and how it works."""

    name: str
    plan: Planner
    what: str
    compiles: bool = False  # at times before a plan, which is not counted
    most: int = MOST_CRAFT  # craft that it is given


@dataclass(frozen=True)
class Verdict:
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


def tandem_x(name: str, file: str, change: tuple[float, float]) -> list[Case]:
    """A change of both vectors, in either norm."""
    whys: dict[Norm, str] = {
        "components": "Arcs again; and states that have the elements exactly differ from the "
        "linear ones by millimetres in the plane, which here are paid besides.",
        "norm": "The same, but what is burned at once in and across the plane is one burn.",
    }
    return [
        Case(name, file, thrust, partial(damico, *change, thrust), "D'Amico's lower bound", why)
        for thrust, why in whys.items()
    ]


ARCS = "Ours are arcs of constant acceleration, theirs impulses, which arcs come near from above"
CASES = (
    Case(
        "SIMBOL-X",
        "simbol-x",
        "components",
        lambda: 1.7913,
        "Arzelier and others 2011",
        f"{ARCS}: 1,200 of them cost 0.09 % more here.",
    ),
    Case(
        "SIMBOL-X",
        "simbol-x",
        "norm",
        lambda: 1.3211,
        "Benedikter and others 2019",
        f"{ARCS}: 1,200 of them cost 0.08 % more here.",
    ),
    *tandem_x("TanDEM-X-like, δi", "tandem-x-plane", (0.0, 100.0)),
    *tandem_x("TanDEM-X-like, δe and δi", "tandem-x-both", (200.0, 200.0)),
    Case(
        "Basilisk's reconfiguration",
        "basilisk-reconfiguration",
        "norm",
        lambda: reconfiguration()[0],
        "bsk 2.12.1, run here",
        "Three burns by a closed form, one for each pair of elements, against the least for the "
        "same two states and time.",
    ),
)

PEERS = (
    Peer("expert", lambda s: solve(s).controls, "this project, apart at all times"),
    Peer(
        "expert, at nodes",
        lambda s: solve(s, requirements=Requirements("nodes")).controls,
        "this project, apart at the nodes only, as the next two",
    ),
    Peer("plain SCP", by_plain_scp, "the paper's kind: every pair at every node, one program"),
    Peer("DCCP", by_dccp, "cvxpy's convex-concave procedure, apart at the nodes", most=10),
    Peer(
        "OpenSCvx",
        by_openscvx,
        "0.5.2 by its own settings, `ctcs` constraints, from decoupled optima; compiled before",
        compiles=True,
        most=10,
    ),
    Peer(
        "decoupled, repaired",
        by_repair,
        "HiGHS for each craft; who meets one of lower number plans anew around all",
    ),
)


def flown(scenario: Scenario, controls: Controls) -> np.ndarray:
    """Node states by the judge: of craft about a circle, or about a Keplerian ellipse."""
    orbit, step = scenario.problem.orbit, scenario.problem.time_step
    if orbit is None:
        return fly(Circle.of(document_of(scenario)), scenario.initial, controls)
    shape = orbit.semi_major_axis, orbit.eccentricity
    begin = np.radians(orbit.argument_of_latitude_deg - orbit.argument_of_perigee_deg)
    states = [scenario.initial]
    for k in range(scenario.problem.intervals):
        here = true_anomaly(*shape, begin, k * step), step
        pushed = controls[:, k] @ forced(*shape, *here).T
        states.append(states[-1] @ yamanaka_ankersen(*shape, *here).T + pushed)
    return np.stack(states, axis=1)


def judged(scenario: Scenario, controls: Controls) -> Verdict:
    """What the judge finds of controls; distances of swarms about circles only."""
    states = flown(scenario, controls)
    miss = np.abs(states[:, -1] - scenario.goal)
    arrives = bool(miss[:, :3].max() <= MISS and miss[:, 3:].max() <= SPEED)
    nodes, always = np.inf, np.inf
    if scenario.n > 1:
        found = closest_approaches(Circle.of(document_of(scenario)), states, controls)
        pairs = states[found.first] - states[found.second]
        nodes, always = np.linalg.norm(pairs[..., :3], axis=2).min(), found.low.min()
    return Verdict(arrives, float(np.abs(controls).sum()), float(nodes), float(always))


def case_row(case: Case, intervals: int | None = None) -> dict[str, object]:
    """Our Δv of a case beside theirs, with other arcs than the file's where that is asked for."""
    scenario = read_scenario(ROOT / f"examples/{case.file}.json")
    problem = scenario.problem
    if intervals is not None:
        step = problem.duration / intervals
        problem = replace(problem, nodes=intervals + 1, time_step=step)
    problem = replace(problem, thrust=replace(problem.thrust, model=case.thrust))
    scenario = replace(scenario, problem=problem)
    controls = solve(scenario).controls
    if not judged(scenario, controls).arrives:
        raise InputError(f"{case.name} misses its goal by the judge; expected a plan that arrives.")
    order = 1 if case.thrust == "components" else 2
    ours = problem.time_step * float(np.linalg.norm(controls, order, axis=2).sum())
    theirs = case.theirs()
    return {
        "case": case.name,
        "file": f"`{case.file}.json`",
        "norm": order,
        "ours, m/s": f"{ours:.4f}",
        "theirs, m/s": f"{theirs:.4f}",
        "ratio": f"{ours / theirs:.4f}",
        "whose": case.source,
        "why they differ": case.why,
    }


def swarm_rows(
    family: str, n: int, count: int, peers: Sequence[Peer] = PEERS
) -> list[dict[str, object]]:
    """What peers make of the same scenarios, in turns; the first is ours."""
    scenarios = [draw(family, SEED, n, k, Problem()) for k in range(count)]
    bounds = [
        least_fuel(Circle.of(document_of(s)), s.initial, s.goal).attained.sum() for s in scenarios
    ]
    peers = [peer for peer in peers if n <= peer.most]
    found: dict[str, list[tuple[Verdict, float]]] = {peer.name: [] for peer in peers}
    solve(scenarios[0])  # what numba compiles is not counted
    for scenario in scenarios:
        for peer in peers:
            if (made := found.get(peer.name)) is not None:
                try:
                    made.append(_timed(peer, scenario))
                except InputError as missing:
                    echo(f"{peer.name} is left out: {missing}")
                    del found[peer.name]
    ours = found[peers[0].name]
    rows = []
    for peer in peers:
        if made := found.get(peer.name):
            safe = np.array([one.safe(Problem().collision_radius) for one, _ in made])
            fuel, seconds = (np.array([(v.fuel, t) for v, t in some]).T for some in (made, ours))
            rows.append(_swarm_row(peer, f"{family}, {n}", safe, (fuel, seconds), bounds))
    return rows


def _swarm_row(
    peer: Peer,
    swarm: str,
    safe: np.ndarray,
    both: tuple[np.ndarray, np.ndarray],
    bounds: Sequence[float],
) -> dict[str, object]:
    (fuel, seconds), (our_fuel, our_seconds) = both
    few = len(fuel)
    return {
        "swarm": swarm,
        "planner": peer.name,
        "safe at nodes": f"{safe[:, 0].sum()} of {few}",
        "safe at all times": f"{safe[:, 1].sum()} of {few}",
        "fuel / least": f"{np.nanmean(fuel / np.array(bounds)):.4f}",
        "fuel / ours": f"{np.nanmean(fuel / our_fuel):.4f}",
        "time, s": f"{seconds.mean():.3g}",
        "time / ours": f"{seconds.mean() / our_seconds.mean():.3g}",
        "how": peer.what,
    }


def _timed(peer: Peer, scenario: Scenario) -> tuple[Verdict, float]:
    if peer.compiles:
        peer.plan(scenario)
    started = process_time()
    try:
        controls = peer.plan(scenario)
    except InputError:
        raise
    except ProlearnError as error:  # there is no plan
        echo(f"{scenario.name}: {error}")
        return Verdict(False, np.nan, 0.0, 0.0), process_time() - started
    taken = process_time() - started
    return judged(scenario, controls), taken


def _versions() -> str:
    found = [f"Python {python_version()}"]
    for package in PACKAGES:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            continue
    return "One core; CPU times; " + ", ".join(found) + "."


def main(
    page: Annotated[Path | None, typer.Option(help="Page whose tables are made anew.")] = None,
) -> None:
    """Run all that is installed and print the tables."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    cases = []
    with threadpool_limits(1):
        for case in CASES:
            try:
                cases.append(case_row(case))
            except InputError as missing:
                echo(f"{case.name} is left out: {missing}")
        swarms = [row for swarm in SWARMS for row in swarm_rows(*swarm)]
    tables = [pd.DataFrame(rows).to_markdown(index=False) for rows in (cases, swarms)]
    text = "\n\n".join([*tables, _versions()])
    echo(text)
    if page is not None:
        before, _, after = page.read_text(encoding="utf-8").split(MARK)
        write_text(page, f"{before}{MARK}\n\n{text}\n\n{MARK}{after}")


if __name__ == "__main__":
    typer.run(main)
