"""Sequential convex programming over clusters of craft in conflict.

The own optimum of every craft comes first: it is the lower bound, and craft without conflict
keep it. Craft that come too close form clusters, and each cluster is solved jointly with
half-space cuts aimed from a trajectory. The iteration cannot cycle:

- cuts, once made, are kept;
- as long as the trajectory aimed from breaks a cut, the newest iterate takes its place;
- once it satisfies all of them it is feasible for every later program, so it is kept until a
  program's optimum proves safe at all times; that iterate costs no more, and is aimed from next.
  One that costs as much all the same, by the margin or by rounding, ends its cluster's search.

A cluster whose program the solver fails at keeps what it has; the others go on. The search ends
with the cheapest iterate of each scenario that it has seen safe as a whole. Scenarios are searched
side by side: what is done for all craft at once is done for all scenarios at once.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from pipeline.arrays import Array
from pipeline.expert import interior_point, simplex
from pipeline.expert.batch import Batch
from pipeline.expert.clusters import Cluster, cluster_labels, members
from pipeline.expert.cuts import NO_CUTS, Cuts, HalfSpaces, gaps, half_spaces
from pipeline.expert.losses import conflicts_asked_about
from pipeline.expert.own import OwnOptima, control_limit
from pipeline.expert.settings import Settings
from pipeline.expert.spread import Spread
from pipeline.expert.standing import Found, Standing
from pipeline.expert.subproblem import Optimum, Subproblem, UnsolvableError
from pipeline.orbit.approaches import PROVABLE
from pipeline.orbit.bezier import norm
from pipeline.orbit.transfer import fly, meet_goal, transfer_maps
from pipeline.plan import Requirements, gap_of

SEED_LOOK = 15.0
"""Pairs that pass within this of the collision radius in a seed are cut from the start, m."""

SHIFT = 1.5
"""By how much further starts move the first gaps at random, in collision radii."""

PENALTY = 1e3
"""Cost of a metre of slack in units of Δt⁻²: above the multiplier of any cut that can be met."""


MOST_ROUNDS_ADRIFT = 30
"""Rounds of a search for passive safety; beyond these another start is likelier to find a plan."""


class Search:
    """The state of one search; ``run`` does all of it.

    Trajectories are held as controls and the node states that they fly: the newest iterate, and
    the one that cuts are aimed from. A craft is active while its cluster is not done, and
    accepted once the trajectory aimed from is known to be safe.
    """

    def __init__(
        self,
        batch: Batch,
        own: OwnOptima,
        settings: Settings,
        requirements: Requirements,
        seeds: Sequence[Float[Array, "_ intervals 3"] | None] | None = None,
        start: int = 0,
        spread: Spread | None = None,
    ) -> None:
        self.batch, self.own, self.settings, self.spread = batch, own, settings, spread
        self.requirements = requirements
        self.problem, self.radius = batch.problem, batch.problem.collision_radius
        self.swarm, count = batch.swarms.label, len(batch.scenarios)
        everyone = np.ones(len(self.swarm), dtype=bool)
        self.accepted, self.active, self.failed = ~everyone, ~everyone, ~everyone
        self.controls, self.states = self._flown(own.controls)
        self.standing = Standing(batch, self.controls)
        within = self.radius + PROVABLE
        cuts, _ = self._conflicts(self.states, self.controls, within, everyone)
        self.aim_controls, self.aim_states = self.controls.copy(), self.states.copy()
        in_conflict = np.isin(np.arange(count), self.swarm[cuts.first])
        if seeds is not None:
            cuts += self._seeded(seeds, in_conflict)
        self.wider = np.zeros(0)
        self._set_cuts(cuts)
        self.active[cuts.first] = self.active[cuts.second] = True
        self.shift: Float[Array, "k 3"] | float = 0.0
        if start:  # other sides to pass on, above all where craft would meet head on
            self.shift = np.zeros((len(cuts), 3))
            for one in members(self.swarm[cuts.first]):
                rng = np.random.default_rng(start)
                self.shift[one] = rng.normal(scale=self.radius * SHIFT, size=(len(one), 3))
        self.standing.remember(self.controls, ~in_conflict)

    def _seeded(
        self,
        seeds: Sequence[Float[Array, "_ intervals 3"] | None],
        in_conflict: Bool[Array, "swarms"],
    ) -> Cuts:
        """Aim scenarios in conflict from their seeds, and cut what comes close there.

        A seed that is safe as it flies is the first iterate: no plan that follows is dearer.
        """
        chosen = {k: seed for k, seed in enumerate(seeds) if seed is not None and in_conflict[k]}
        if not chosen:
            return NO_CUTS
        given = np.isin(self.swarm, list(chosen))
        flown = self._flown(np.concatenate(list(chosen.values())), given)
        self.aim_controls[given], self.aim_states[given] = flown
        near, bound = self._conflicts(
            self.aim_states,
            self.aim_controls,
            self.radius + SEED_LOOK,
            given,
            beside=self.settings.beside,
        )
        too_much = np.abs(self.aim_controls).max(axis=(1, 2)) > control_limit(self.problem)
        unfit = near.first[bound <= self.radius + PROVABLE], np.flatnonzero(too_much)
        safe = np.zeros(len(self.batch.scenarios), dtype=bool)
        safe[list(chosen)] = True
        safe[self.swarm[np.concatenate(unfit)]] = False
        self.standing.remember(self.aim_controls, safe)
        return near

    def run(self) -> list[Found]:
        """Solve and judge until every cluster is done."""
        most = self.settings.max_rounds
        if self.requirements.passive_safety is not None:
            most = min(most, MOST_ROUNDS_ADRIFT)
        for _ in range(most):
            if not self.active.any():
                break
            self.standing.begin_round(self.active)
            clusters = self._solve(self._clusters(self.active))
            if clusters:
                self._judge(clusters)
        kept = self.accepted & (self.active | self.failed)
        self.controls[kept] = self.aim_controls[kept]
        return self.standing.found(self.controls, self.cuts, self.active & ~kept)

    def _flown(
        self,
        controls: Float[Array, "n intervals 3"],
        craft: Cluster | Bool[Array, "_"] | slice = slice(None),
    ) -> tuple[Float[Array, "n intervals 3"], Float[Array, "n T 6"]]:
        initial, goal = self.batch.initial[craft], self.batch.goal[craft]
        exact = meet_goal(initial, controls, goal, self.problem)
        return exact, fly(initial, exact, self.problem)

    def _conflicts(
        self,
        states: Float[Array, "n T 6"],
        controls: Float[Array, "n intervals 3"],
        within: float,
        moved: Bool[Array, "n"],
        *,
        beside: float = 0.0,
    ) -> tuple[Cuts, Float[Array, "k"]]:
        return conflicts_asked_about(
            states,
            controls,
            self.problem,
            within,
            moved,
            self.requirements,
            margin=self.settings.margin,
            spread=self.spread,
            swarms=self.batch.swarms,
            beside=beside,
        )

    def _widths(
        self, states: Float[Array, "n T 6"], controls: Float[Array, "n intervals 3"]
    ) -> Float[Array, "k"] | float:
        """What a trajectory's errors ask of each cut besides the collision radius, m."""
        if self.spread is None:
            return 0.0
        return self.spread.widths(self.cuts, states, controls, self.problem, self.settings.margin)

    def _set_cuts(self, cuts: Cuts) -> None:
        self.cuts = cuts
        self.wider = np.append(self.wider, np.zeros(len(cuts) - len(self.wider)))
        self.labels = cluster_labels(len(self.swarm), cuts.first, cuts.second)
        self.cuts_of = {
            int(self.labels[cuts.first[one[0]]]): one for one in members(self.labels[cuts.first])
        }

    def _clusters(self, touched: Bool[Array, "n"]) -> list[Cluster]:
        """The clusters that some craft are in."""
        there = np.zeros(len(self.labels), dtype=bool)
        there[self.labels[touched]] = True
        craft = np.flatnonzero(there[self.labels])
        return [craft[one] for one in members(self.labels[craft])]

    def _distances(
        self, states: Float[Array, "n T 6"], controls: Float[Array, "n intervals 3"]
    ) -> Float[Array, "k"]:
        """Separation of each cut's pair in a trajectory, less its width, m."""
        return norm(gaps(self.cuts, states, controls)) - self._widths(states, controls)

    def _solve(self, clusters: list[Cluster]) -> list[Cluster]:
        """Solve each cluster's program, with every cut aimed from the same trajectory.

        Returns:
            The clusters that moved. Where the solver fails, or where a safe iterate is known and
            the program's is no cheaper, the cluster is done and goes back to what it has.
        """
        # Never less than before: burns, and so errors, that take turns would cycle.
        self.wider = np.maximum(self.wider, self._widths(self.aim_states, self.aim_controls))
        aimed = half_spaces(
            self.cuts,
            self.aim_states,
            self.aim_controls,
            self.problem,
            self.radius + self.settings.margin + self.wider,
            self.shift,
        )
        self.shift = 0.0  # for the first program alone
        self.price = np.zeros(len(self.cuts))
        for craft in clusters:
            own_cuts = self.cuts_of[int(craft[0])]
            try:
                best = self._solve_cluster(craft, own_cuts, aimed)
            except UnsolvableError as error:
                self._fail(craft, str(error))
                continue
            self.controls[craft] = best.controls.reshape(len(craft), -1, 3)
            self.price[own_cuts] = best.price
            k = int(best.slack.argmax())
            i, j = self.cuts.first[own_cuts[k]], self.cuts.second[own_cuts[k]]
            self.standing.note_slack(int(i), int(j), float(best.slack[k]))
        for craft in clusters:
            if self.accepted[craft].all() and self._fuel(self.controls, craft) >= self._fuel(
                self.aim_controls, craft
            ):
                self._go_back(craft)
        moved = np.concatenate(clusters)
        self.controls[moved], self.states[moved] = self._flown(self.controls[moved], moved)
        return [craft for craft in clusters if not self.failed[craft].any()]

    def _fuel(self, controls: Float[Array, "n intervals 3"], craft: Cluster) -> float:
        return float(np.abs(controls[craft]).sum())

    def _go_back(self, craft: Cluster) -> None:
        """Take the safe iterate that is known for good; it is judged again, for others moved."""
        self.controls[craft] = self.aim_controls[craft]
        self.active[craft] = False

    def _fail(self, craft: Cluster, why: str) -> None:
        """Leave a cluster as it is, or was when it was safe."""
        self.standing.fail(int(craft[0]), why)
        if self.accepted[craft].all():
            self._go_back(craft)
        else:
            self.active[craft], self.failed[craft] = False, True

    def _solve_cluster(self, craft: Cluster, cuts: Cluster, aimed: HalfSpaces) -> Optimum:
        sub = Subproblem(
            reach=transfer_maps(self.problem).reach[-1],
            miss=self.batch.miss[craft],
            first=np.searchsorted(craft, self.cuts.first[cuts]),
            second=np.searchsorted(craft, self.cuts.second[cuts]),
            row=aimed.row[cuts],
            required=aimed.required[cuts],
            other=None if aimed.other is None else aimed.other[cuts],
            limit=control_limit(self.problem),
            penalty=PENALTY / self.problem.time_step**2,
            unit=float(self.batch.unit[self.swarm[craft[0]]]),
            basis=None if self.own.basis is None else self.own.basis[craft],
        )
        if self.settings.solver == "simplex":
            return simplex.solve(sub)
        return interior_point.solve(sub)

    def _judge(self, clusters: list[Cluster]) -> None:
        """Accept the clusters whose new iterate is safe, and cut the others where it is not."""
        moved = np.zeros(len(self.swarm), dtype=bool)
        moved[np.concatenate(clusters)] = True
        within = self.radius + self.settings.look_ahead
        found, bound = self._conflicts(self.states, self.controls, within, moved)
        broken = bound <= self.radius + PROVABLE  # so that the certificate proves the rest safe
        unsafe = np.zeros(len(self.swarm), dtype=bool)
        unsafe[found.first[broken]] = unsafe[found.second[broken]] = True
        promised = self._promised_gains()
        for craft in clusters:
            if self.active[craft].any() and not unsafe[craft].any():
                self._accept(craft, float(promised[craft[0]]))
        safe = np.ones(len(self.batch.scenarios), dtype=bool)
        safe[self.swarm[unsafe | self.failed]] = False
        self.standing.remember(self.controls, safe)
        if broken.any():
            again = np.isin(self.swarm[found.first], self.swarm[found.first[broken]])
            self._set_cuts(self.cuts + found.where(again & (self.active[found.first] | broken)))
            self.wider = np.maximum(self.wider, self._widths(self.states, self.controls))
            self._choose_aim(unsafe)

    def _promised_gains(self) -> Float[Array, "n"]:
        """What aiming anew from the newest iterate can gain in each cluster, to first order.

        A cut held the pair to the separation along its old normal; along the new one the pair is
        further apart, by a surplus that is worth the cut's multiplier.
        """
        surplus = self._distances(self.states, self.controls) - (self.radius + self.settings.margin)
        worth = self.price * np.maximum(surplus, 0.0)
        return np.bincount(self.labels[self.cuts.first], worth, len(self.swarm))

    def _accept(self, craft: Cluster, promised: float) -> None:
        """Aim from a safe iterate from now on; done where that promises no more."""
        settings, fuel = self.settings, self._fuel(self.controls, craft)
        before = self._fuel(self.aim_controls, craft)
        gained = before - fuel if self.accepted[craft].all() else np.inf
        self.aim_controls[craft] = self.controls[craft]
        self.aim_states[craft] = self.states[craft]
        self.accepted[craft] = True
        gap = gap_of(fuel, float(self.own.lower_bound[craft].sum()), self.problem)
        self.active[craft] = not (
            settings.stop == "first-safe"
            or gap <= settings.gap_tolerance
            or min(gained, promised) <= settings.improvement * fuel
        )

    def _choose_aim(self, unsafe: Bool[Array, "n"]) -> None:
        """Keep aims that satisfy all their cuts; others move on to the newest iterate."""
        broken = self._distances(self.aim_states, self.aim_controls) <= self.radius
        missed = self.labels[self.cuts.first[broken]]
        for craft in self._clusters(unsafe):
            self.active[craft], self.failed[craft] = True, False
            if craft[0] in missed:
                self.aim_controls[craft] = self.controls[craft]
                self.aim_states[craft] = self.states[craft]
                self.accepted[craft] = False
