"""A proven lower bound on the fuel of any safe plan, by spatial branch and bound.

    python -m benchmarks.floor --instances 100

`fuel_lower_bound` ignores that craft must keep apart, so some of every gap is the price of
safety and no planner's fault. This bound, the floor, shows how much. The craft are parted
into clusters; what a cluster needs at least, whatever the others do, is a bound, and so is the
sum over clusters. Within a cluster a node of the tree holds, for some pairs and times τ, a
spherical triangle that the direction of the gap d = pᵢ(τ) - pⱼ(τ) is to lie in. For corners v₁,
v₂, v₃ and the unit normal h of the plane through them (h·v₁ > 0), a unit vector in the
triangle is Σ αₖvₖ with α ≥ 0 and, by the triangle inequality, Σ αₖ ≥ 1; so |d| ≥ r implies

    d in the cone of v₁, v₂, v₃    and    h·d ≥ r h·v₁,

which is linear: the node's program is a relaxation of all safe plans that pass on these sides.
Where its optimum brings a pair too close, either that pair's triangle is split into four or, at
another time, the whole sphere into eight; the children cover all that their parent did. The
least bound of any open node is a floor at every moment of the search, so the search may stop at
a limit: an instance left open has a floor that is valid, only lower than it could be. As for the
decoupled optima, the bound of a program is what its dual variables prove, not what the solver
reports.
"""

from dataclasses import dataclass, field
from heapq import heappop, heappush
from itertools import product
from time import process_time
from typing import Annotated

import numpy as np
import typer
from jaxtyping import Float, Int
from threadpoolctl import threadpool_limits

from benchmarks.tables import show
from cli.output import echo
from pipeline.arrays import Array
from pipeline.expert import BEST, decoupled_optima, solve
from pipeline.expert.conflicts import ConflictDetection, Trajectory
from pipeline.expert.cuts import NO_CUTS, Cuts, gaps, half_spaces
from pipeline.expert.decoupled import control_units, goal_miss
from pipeline.expert.scp import PENALTY, cluster_labels
from pipeline.expert.solvers import clarabel_solver
from pipeline.expert.subproblem import LENGTH, Subproblem
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly, meet_goal, transfer_maps
from pipeline.plan import Plan
from pipeline.scenario import Scenario, draw

TIGHT = 0.1  # pairs that a plan brings within this of the collision radius belong together, m
ENOUGH = 0.99  # share of the plan's extra fuel whose proof is enough for a cluster
OPEN = 0.01  # instances whose gap is further above their floor count as open, in percent
OLD_TIMES_FIRST = 0.8  # share of the worst gap at which a triangle is split, not a time added

Corners = Float[Array, "k 3 3"]


def main(
    instances: Annotated[int, typer.Option(help="Instances 0, 1, ... of the draw.")] = 100,
    n: Annotated[int, typer.Option(help="Swarm size.")] = 10,
    seed: Annotated[int, typer.Option(help="Root seed of the draw.")] = 0,
    family: Annotated[str, typer.Option(help="Family of scenarios.")] = "rings",
    programs: Annotated[int, typer.Option(help="Programs that a cluster may take.")] = 300,
) -> None:
    """Compare the gap of the expert's best plans with the floor under any safe plan's."""
    started = process_time()
    with threadpool_limits(1):
        found = [
            floor_and_gaps(draw(family, seed, n, index, Problem()), programs)
            for index in range(instances)
        ]
    floor, gap, default = 100 * np.array(found).T
    took = process_time() - started
    measured = {
        "gap of the expert's usual plans": default,
        "gap of the expert's best plans": gap,
        "proven floor of any safe plan's": floor,
        "difference: can be gained at most": gap - floor,
    }
    rows = [
        {"": what, "%": f"{k.mean():.4f}", "±": f"{k.std(ddof=1) / len(k) ** 0.5:.4f}"}
        for what, k in measured.items()
    ]
    show(f"{family}, seed {seed}, n = {n}, {instances} instances, {took:.0f} s", rows)
    echo(f"instances open by over {OPEN} %: {int((gap - floor > OPEN).sum())}")
    if (left := float((default - floor).sum())) > 0:
        won = float((default - gap).sum()) / left
        echo(f"best plans gain at least {won:.0%} of what usual ones leave above the floor")


def floor_and_gaps(scenario: Scenario, programs: int) -> tuple[float, float, float]:
    """What the gap of any safe plan is at least, and those of the expert's best and usual plan."""
    own = decoupled_optima(scenario.initial, scenario.goal, scenario.problem)
    plan = solve(scenario, settings=BEST)
    used = np.abs(plan.controls).sum(axis=(1, 2))
    labels = _labels(scenario, own.controls, plan)
    floor = 0.0
    for label in np.unique(labels):
        craft = np.flatnonzero(labels == label)
        alone, spent = float(own.lower_bound[craft].sum()), float(used[craft].sum())
        if len(craft) > 1:
            target = alone + ENOUGH * (spent - alone)
            part = Scenario(scenario.problem, scenario.initial[craft], scenario.goal[craft])
            alone = max(alone, Tree(part).bound(target, programs))
        floor += alone
    usual, best = solve(scenario).certificate, plan.certificate
    return floor / best.fuel_lower_bound - 1, best.optimality_gap, usual.optimality_gap


@dataclass(order=True)
class Node:
    """Triangles for some pairs and times, and what safe plans within them cost at least."""

    bound: float  # lower bound on the fuel, m/s²
    number: int  # which settles the order of nodes with equal bounds
    cuts: Cuts = field(compare=False)  # pairs and times
    corners: Corners = field(compare=False)  # unit vectors, counter-clockwise seen from outside
    # optimum of the relaxation, m/s²
    controls: Float[Array, "n intervals 3"] = field(compare=False)


class Tree:
    """Best-first branch and bound on the fuel of a few craft that must keep apart."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self.problem = scenario, scenario.problem
        self.miss = goal_miss(scenario.initial, scenario.goal, self.problem)
        self.unit = float(control_units(self.miss, self.problem).max())
        self.programs = 0

    def bound(self, target: float, programs: int) -> float:
        """Lower bound on the fuel of any safe plan, m/s²; no better than ``target`` is wanted."""
        nodes = [self._node(NO_CUTS, np.zeros((0, 3, 3)), 0.0)]
        while nodes[0].bound < target and self.programs < programs:
            node = nodes[0]
            children = self._children(node)
            if not children:
                break  # the relaxation's optimum is safe: it is the optimum
            heappop(nodes)
            for child in children:
                heappush(nodes, child)
        return nodes[0].bound

    def _children(self, node: Node) -> list[Node]:
        """Nodes that cover all safe plans of a node, but not its optimum; none if that is safe."""
        controls, radius = node.controls, self.problem.collision_radius
        states = fly(self.scenario.initial, controls, self.problem)
        flown = Trajectory(controls, states)
        close, distance = ConflictDetection(self.problem).conflicts(flown, radius)
        if len(close) == 0:
            return []
        worst = int(distance.argmin())
        gap = np.linalg.norm(gaps(node.cuts, states, controls), axis=1)
        if len(gap) and radius - gap.min() >= OLD_TIMES_FIRST * (radius - distance[worst]):
            k = int(gap.argmin())
            cuts, others = node.cuts, np.delete(node.corners, k, axis=0)
            triangles, place = quarters(node.corners[k]), k
        else:
            cuts, others = node.cuts + close[np.array([worst])], node.corners
            triangles, place = OCTANTS, len(others)
        return [
            self._node(cuts, np.insert(others, place, triangle, axis=0), node.bound)
            for triangle in triangles
        ]

    def _node(self, cuts: Cuts, corners: Corners, at_least: float) -> Node:
        """Solve the relaxation that triangles stand for."""
        self.programs += 1
        sub = self._relaxation(cuts, corners)
        found = clarabel_solver(sub).solve()
        controls = sub.controls_of(np.asarray(found.x)).reshape(len(sub.miss), -1, 3)
        exact = meet_goal(self.scenario.initial, controls, self.scenario.goal, self.problem)
        bound = max(proven(sub, np.asarray(found.z)), at_least)
        return Node(bound, self.programs, cuts, corners, exact)

    def _relaxation(self, cuts: Cuts, corners: Corners) -> Subproblem:
        normal, share = relaxed(corners)
        fourfold = cuts[np.repeat(np.arange(len(cuts)), 4)]
        linear = half_spaces(
            fourfold,
            normal.reshape(-1, 3),
            self.scenario.initial,
            self.problem,
            self.problem.collision_radius * share.ravel(),
        )
        return Subproblem(
            reach=transfer_maps(self.problem).reach[-1],
            miss=self.miss,
            first=fourfold.first,
            second=fourfold.second,
            row=linear.row,
            required=linear.required,
            limit=np.inf,
            penalty=PENALTY / self.problem.time_step**2,
            unit=self.unit,
        )


def relaxed(corners: Corners) -> tuple[Float[Array, "k 4 3"], Float[Array, "k 4"]]:
    """Half-spaces normal · d ≥ share · r that hold for |d| ≥ r with d/|d| in a triangle."""
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.stack([np.cross(a, b), np.cross(b, c), np.cross(c, a), np.cross(b - a, c - a)], 1)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    share = np.zeros(normal.shape[:2])
    share[:, 3] = (normal[:, 3] * a).sum(axis=1)
    return normal, share


def quarters(triangle: Float[Array, "3 3"]) -> Float[Array, "4 3 3"]:
    """A spherical triangle cut into four at the middles of its sides."""
    a, b, c = triangle
    middles = np.stack([a + b, b + c, c + a])
    p, q, r = middles / np.linalg.norm(middles, axis=1, keepdims=True)
    return np.array([[a, p, r], [p, b, q], [r, q, c], [p, q, r]])


SIGNS = np.array(list(product([1.0, -1.0], repeat=3)))
OCTANTS = np.array([np.diag(s) if s.prod() > 0 else np.diag(s)[::-1] for s in SIGNS])
"""The sphere in eight triangles."""


def proven(sub: Subproblem, z: Float[Array, "rows"]) -> float:
    """The lower bound that multipliers of a program prove, however they were found.

    For y and price ≥ 0, miss·y + required·price is a lower bound where no control's price,
    reachᵀy + Σ ± row price, exceeds 1 in absolute value (linear programming duality); all are
    shrunk until none does.
    """
    n, _, k = sub.shape
    y = -z[: 6 * n].reshape(n, 6) * sub.goal_scale * sub.unit
    price = sub.unit / LENGTH * np.maximum(z[len(z) - k :], 0.0)
    cost = y @ sub.reach
    np.add.at(cost, sub.first, price[:, None] * sub.row)
    np.subtract.at(cost, sub.second, price[:, None] * sub.row)
    worth = float((sub.miss * y).sum() + sub.required @ price)
    return worth / max(1.0, float(np.abs(cost).max()))


def _labels(scenario: Scenario, own: Float[Array, "n intervals 3"], plan: Plan) -> Int[Array, "n"]:
    """Clusters of craft that come close in their decoupled optima or in the plan."""
    near, detection = NO_CUTS, ConflictDetection(scenario.problem)
    for controls in (own, plan.controls):
        flown = Trajectory(controls, fly(scenario.initial, controls, scenario.problem))
        found, _ = detection.conflicts(flown, scenario.problem.collision_radius + TIGHT)
        near += found
    return cluster_labels(scenario.n, near.first, near.second)


if __name__ == "__main__":
    typer.run(main)
