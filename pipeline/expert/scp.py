"""Sequential convex programming over clusters of craft in conflict.

The own optimum of every craft comes first: it is the lower bound, and craft without conflict
keep it. Craft that come too close form clusters, and each cluster is solved jointly with
half-space cuts aimed from a trajectory. The iteration cannot cycle:

- cuts, once made, are kept;
- as long as the trajectory aimed from breaks a cut, the newest iterate takes its place;
- once it satisfies all of them it is feasible for every later program, so it is kept until a
  program's optimum proves safe at all times; that iterate costs no more, and is aimed from next.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pipeline.arrays import Array
from pipeline.expert import interior_point, reference
from pipeline.expert.cuts import Cuts, conflicts, half_spaces
from pipeline.expert.own import OwnOptima, control_limit, control_unit, goal_miss
from pipeline.expert.subproblem import Subproblem, UnsolvableError
from pipeline.orbit.separation import TOLERANCE
from pipeline.orbit.transfer import fly, meet_goal, transfer_maps
from pipeline.plan import gap_of
from pipeline.scenario import Scenario

MARGIN = 2e-3
"""Separation asked for beyond the collision radius, m: covers the solver's tolerance."""

LOOK_AHEAD = 0.5
"""Pairs that pass within this of the collision radius are cut before they violate it, m."""

SLACK_TOLERANCE = 1e-5
"""Slack in m under which a half-space counts as met."""

SEED_LOOK = 15.0
"""Pairs that pass within this of the collision radius in a seed are cut from the start, m."""

PENALTY = 1e3
"""Cost of a metre of slack in units of Δt⁻²: above the multiplier of any cut that can be met."""

SOLVERS = {"clarabel": interior_point.solve, "cvxpy": reference.solve}


Cluster = Int[Array, "_"]
"""Craft that are solved jointly."""


@dataclass(frozen=True)
class Settings:
    """How the expert works.

    Attributes:
        separation: keep craft apart at all times, or at the nodes only as in the paper.
        stop: go on until the plan no longer improves, or stop at the first safe one.
        gap_tolerance: a cluster whose optimality gap is below this is done.
        improvement: relative improvement below which a cluster is done.
        max_rounds: programs that a cluster may take.
        solver: the subproblem by Clarabel directly, or by its readable form in cvxpy.
    """

    separation: Literal["continuous", "nodes"] = "continuous"
    stop: Literal["converged", "first-safe"] = "converged"
    gap_tolerance: float = 1e-4
    improvement: float = 2e-4
    max_rounds: int = 60
    solver: Literal["clarabel", "cvxpy"] = "clarabel"


@dataclass(frozen=True, eq=False)
class Found:
    """What the search ended with.

    Attributes:
        controls: (n, T-1, 3), m/s².
        convex_solves: rounds of programs, the clusters of a round counted as one.
        obstacle: why no plan exists, or nothing.
    """

    controls: Float[Array, "n intervals 3"]
    convex_solves: int
    obstacle: str = ""


class Search:
    """The state of one search; ``run`` does all of it."""

    def __init__(
        self,
        scenario: Scenario,
        own: OwnOptima,
        seed: Float[Array, "n intervals 3"] | None,
        settings: Settings,
    ) -> None:
        self.scenario, self.own, self.settings = scenario, own, settings
        self.problem = scenario.problem
        self.radius = self.problem.collision_radius
        self.miss = goal_miss(scenario.initial, scenario.goal, self.problem)
        self.unit = control_unit(scenario.initial, scenario.goal, self.problem)
        everyone = np.ones(scenario.n, dtype=bool)
        self.controls, self.states = self._flown(own.controls)
        self.cuts, _ = self._conflicts(self.states, self.controls, self.radius, everyone)
        self.aim_controls, self.aim_states = self.controls.copy(), self.states.copy()
        if seed is not None and len(self.cuts):
            self.aim_controls, self.aim_states = self._flown(seed)
            self.cuts += self._conflicts(
                self.aim_states, self.aim_controls, self.radius + SEED_LOOK, everyone
            )[0]
        self.accepted = np.zeros(scenario.n, dtype=bool)
        self.active = np.zeros(scenario.n, dtype=bool)
        self._activate(self.cuts)
        self.worst: tuple[float, int, int] = (0.0, 0, 0)

    def run(self) -> Found:
        """Solve and judge until every cluster is done."""
        rounds = 0
        while self.active.any() and rounds < self.settings.max_rounds:
            rounds += 1
            clusters = self._active_clusters()
            try:
                self._solve(clusters)
            except UnsolvableError as error:
                return Found(self.controls, rounds, str(error))
            self._judge(clusters)
        kept = self.active & self.accepted
        self.controls[kept] = self.aim_controls[kept]
        return Found(self.controls, rounds, self._obstacle(kept))

    def _obstacle(self, kept: Bool[Array, "n"]) -> str:
        """The pair that no program could hold apart, where one stands in the way."""
        slack, i, j = self.worst
        if not (self.active & ~kept).any() or slack < SLACK_TOLERANCE:
            return ""
        return (
            f"craft {i} and {j} cannot be kept {self.radius:g} m apart: {slack:.3g} m are missing"
        )

    def _flown(
        self, controls: Float[Array, "n intervals 3"]
    ) -> tuple[Float[Array, "n intervals 3"], Float[Array, "n T 6"]]:
        exact = meet_goal(self.scenario.initial, controls, self.scenario.goal, self.problem)
        return exact, fly(self.scenario.initial, exact, self.problem)

    def _conflicts(
        self,
        states: Float[Array, "n T 6"],
        controls: Float[Array, "n intervals 3"],
        within: float,
        moved: Bool[Array, "n"],
    ) -> tuple[Cuts, Float[Array, "k"]]:
        at_nodes = self.settings.separation == "nodes"
        return conflicts(states, controls, self.problem, within, moved, at_nodes=at_nodes)

    def _activate(self, cuts: Cuts) -> None:
        self.active[cuts.first] = self.active[cuts.second] = True

    def _labels(self) -> Int[Array, "n"]:
        """Which cluster each craft is in: craft joined by cuts, directly or through others."""
        n = self.scenario.n
        joined = (np.ones(len(self.cuts)), (self.cuts.first, self.cuts.second))
        labels: Int[Array, n] = connected_components(coo_array(joined, (n, n)), directed=False)[1]
        return labels

    def _active_clusters(self) -> list[Cluster]:
        labels = self._labels()
        return [np.flatnonzero(labels == label) for label in np.unique(labels[self.active])]

    def _solve(self, clusters: list[Cluster]) -> None:
        """Solve each cluster's program, with every cut aimed from the same trajectory."""
        self.worst = (0.0, 0, 0)
        place = np.zeros(self.scenario.n, dtype=int)
        for craft in clusters:
            place[craft] = np.arange(len(craft))
            cuts = self.cuts.where(np.isin(self.cuts.first, craft))
            aimed = half_spaces(
                cuts, self.aim_states, self.aim_controls, self.problem, self.radius + MARGIN
            )
            sub = Subproblem(
                reach=transfer_maps(self.problem).reach[-1],
                miss=self.miss[craft],
                first=place[cuts.first],
                second=place[cuts.second],
                row=aimed.row,
                required=aimed.required,
                limit=control_limit(self.problem),
                penalty=PENALTY / self.problem.time_step**2,
                unit=self.unit,
            )
            best = SOLVERS[self.settings.solver](sub)
            self.controls[craft] = best.controls.reshape(len(craft), -1, 3)
            k = int(best.slack.argmax())
            self.worst = max(
                self.worst, (float(best.slack[k]), int(cuts.first[k]), int(cuts.second[k]))
            )
        self.controls, self.states = self._flown(self.controls)

    def _judge(self, clusters: list[Cluster]) -> None:
        """Accept the clusters whose new iterate is safe, and cut the others where it is not."""
        moved = np.zeros(self.scenario.n, dtype=bool)
        moved[np.concatenate(clusters)] = True
        found, bound = self._conflicts(self.states, self.controls, self.radius + LOOK_AHEAD, moved)
        broken = bound <= self.radius + TOLERANCE  # so that any later bracket proves it safe
        unsafe = np.zeros(self.scenario.n, dtype=bool)
        unsafe[found.first[broken]] = unsafe[found.second[broken]] = True
        for craft in clusters:
            if not unsafe[craft].any():
                self._accept(craft)
        if broken.any():
            self.cuts += found.where(self.active[found.first] | broken)
            self._activate(found.where(broken))
            self._choose_aim(unsafe)

    def _accept(self, craft: Cluster) -> None:
        """Aim from a safe iterate from now on; done where that gains no more."""
        settings = self.settings
        fuel = float(np.abs(self.controls[craft]).sum())
        before = float(np.abs(self.aim_controls[craft]).sum())
        gained = before - fuel if self.accepted[craft].all() else np.inf
        self.aim_controls[craft] = self.controls[craft]
        self.aim_states[craft] = self.states[craft]
        self.accepted[craft] = True
        gap = gap_of(fuel, float(self.own.lower_bound[craft].sum()))
        done = (
            settings.stop == "first-safe"
            or gap <= settings.gap_tolerance
            or gained <= settings.improvement * fuel
        )
        self.active[craft] = not done

    def _choose_aim(self, unsafe: Bool[Array, "n"]) -> None:
        """Keep aims that satisfy all their cuts; others move on to the newest iterate."""
        labels = self._labels()
        aimed = half_spaces(
            self.cuts, self.aim_states, self.aim_controls, self.problem, self.radius
        )
        missed = labels[self.cuts.first[aimed.distance <= self.radius]]
        for label in np.unique(labels[unsafe]):
            craft = np.flatnonzero(labels == label)
            self.active[craft] = True
            if label in missed:
                self.aim_controls[craft] = self.controls[craft]
                self.aim_states[craft] = self.states[craft]
                self.accepted[craft] = False
