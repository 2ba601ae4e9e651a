"""Sequential convex programming over clusters of craft in conflict.

The decoupled optimum of every craft comes first: it gives the lower bound, and craft without
conflict keep it. Craft that come too close form clusters, and each cluster is solved jointly with
half-space cuts linearized about a trajectory. Small clusters of a scenario share a program; in a
large one, from some round on, only craft near unsafe ones are variables, with the controls of all
others fixed; mixed-integer programs of all but small clusters have one craft at a time. The
iteration cannot cycle:

- cuts, once made, are kept;
- as long as the linearization point violates a cut, the newest iterate takes its place;
- once it satisfies all of them it is feasible for every later program, so it is kept until a
  program's optimum proves safe at all times; that iterate costs no more, and is the next
  linearization point. One that costs as much all the same, by the margin or by rounding, ends its
  cluster's search.

A cluster whose program fails keeps its iterate; the others go on. The search ends with the
cheapest iterate of each scenario that was safe as a whole. Scenarios are searched together:
operations on all craft act on all scenarios at once.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pipeline.arrays import Array, Bool, Float, Int
from pipeline.expert.batch import Batch
from pipeline.expert.clusters import (
    VAST,
    Bases,
    Cluster,
    cluster_labels,
    groups,
    joint_clusters,
    neighbourhoods,
    with_others_fixed,
)
from pipeline.expert.conflicts import BackOff, ConflictDetection, Trajectory
from pipeline.expert.conic import by_cones
from pipeline.expert.conic_decoupled import polished, program_limits
from pipeline.expert.cuts import Cuts, HalfSpaces, gaps, half_spaces, normals
from pipeline.expert.decoupled import control_limit
from pipeline.expert.incumbents import SLACK_TOLERANCE, Incumbents, SearchResult
from pipeline.expert.settings import Settings
from pipeline.expert.solvers import by_simplex
from pipeline.expert.subproblem import Basis, Optimum, Subproblem, UnsolvableError
from pipeline.orbit.approaches import PROVABLE
from pipeline.orbit.arrays import Controls, CraftMask, Indices, Values, Vectors, norm
from pipeline.orbit.thrust_cost import exceeded_limits
from pipeline.orbit.transfer import fly, meet_goal, transfer_maps
from pipeline.plan.certificate import gap_of
from pipeline.plan.requirements import Requirements

SEED_LOOK = 15.0  # pairs of a seed nearer than this plus the collision radius are cut at once, m
SHIFT = 1.5  # standard deviation of further starts' random shifts of gaps, in collision radii
PENALTY = 1e3  # of a metre of slack, in Δt⁻²: above the dual of any cut that can be met
MOST_ROUNDS_PASSIVE = 30  # after which another start is likelier to be passively safe
# Rounds in which a cluster's largest slack stays the same, after which another start is likelier to
# be passively safe, too; and the share of a slack up to which it is the same
STALLED, SAME = 2, 0.02

STILL = 1e-10  # share of a typical control up to which a change of a control is none
FEW = 3  # craft of a cluster up to which one mixed-integer program has all of them
LARGE = 200  # craft of a cluster from which on only pairs of craft that changed are checked again

Seeds = Sequence[Float[Array, "_ intervals 3"] | None]  # controls that fly a seed, or None


@dataclass(frozen=True, eq=False)
class SearchProblem:
    """The input of a search: scenarios, settings, requirements and perhaps a back-off."""

    batch: Batch  # the scenarios
    settings: Settings  # of the expert
    requirements: Requirements  # what the plans must satisfy, without a risk limit
    back_off: BackOff | None = None  # beyond the collision radius, because of errors
    whole_burns: bool = False  # whether programs have the minimum impulse bit

    @cached_property
    def detection(self) -> ConflictDetection:
        """The conflict detection of these requirements."""
        problem, swarms, settings = self.batch.problem, self.batch.swarms, self.settings
        margin = float(settings.margin_at(np.array(problem.collision_radius)))
        return ConflictDetection(problem, self.requirements, swarms, margin, self.back_off)

    def part(self, which: Sequence[int]) -> "SearchProblem":
        """The search for some of the scenarios."""
        if len(which) == len(self.batch.scenarios):
            return self
        return replace(self, batch=self.batch.part(which))


class Search:
    """A search and its state; ``run`` executes it.

    It is linearized at first about seeds, or else about decoupled optima. Further starts, numbered
    from 1, first shift gaps at random, so that craft pass on other sides.
    """

    def __init__(self, task: SearchProblem, seeds: Seeds | None = None, start: int = 0) -> None:
        self.task, self.settings, self.batch = task, task.settings, task.batch
        self.problem, self.swarm = self.batch.problem, self.batch.swarms.label
        self.provable = self.problem.collision_radius + PROVABLE
        # Craft whose part of the reference is known to be safe, whose cluster is not done, and
        # whose cluster's program failed.
        self.accepted, self.active, self.failed = np.zeros((3, len(self.swarm)), dtype=bool)
        # Largest slack of the last program of each craft's cluster, m, and rounds since it changed.
        self.slack, self.stalled = np.zeros(len(self.swarm)), np.zeros(len(self.swarm), dtype=int)
        controls = self.batch.optima.controls.copy()
        # The newest trajectory.
        self.iterate = Trajectory(controls, fly(self.batch.initial, controls, self.problem))
        # The linearization point.
        self.reference = Trajectory(self.iterate.controls.copy(), self.iterate.states.copy())
        self.incumbents = Incumbents(self.batch, self.iterate.controls)
        cuts, _ = task.detection.conflicts(self.iterate, self.provable)
        in_conflict = self._scenarios(cuts.first)
        if seeds is not None:
            cuts = self._seeded(cuts, seeds, in_conflict)
        # For each cut: separation required beyond radius and margin, m; its dual variable in its
        # last program, m/s² per m; radius plus margin, m.
        self.back_off, self.dual, self.separation = np.zeros((3, 0))
        self.bases = Bases(self.batch.optima.basis, 3 * self.problem.intervals)
        self._set_cuts(cuts)
        self.active[cuts.first] = self.active[cuts.second] = True
        if task.whole_burns:  # where craft are fixed before their turn
            self.iterate.set(self.active, self.reference[self.active])
        # Controls when pairs were last checked, and craft that were unsafe then.
        self.checked, self.unsafe = self.iterate.controls.copy(), self.active.copy()
        self.shift = self._first_shift(start)
        self.incumbents.update(self.iterate.controls, ~in_conflict)

    def _scenarios(self, craft: Indices | CraftMask) -> Bool[Array, "scenarios"]:
        """Mask of the scenarios to which some craft belong."""
        there = np.zeros(len(self.batch.scenarios), dtype=bool)
        there[self.swarm[craft]] = True
        return there

    def _seeded(self, cuts: Cuts, seeds: Seeds, in_conflict: Bool[Array, "swarms"]) -> Cuts:
        """Linearize scenarios in conflict about their seeds, and add cuts of close pairs there.

        A seed that is safe as flown is the first incumbent, so no result costs more.
        """
        chosen = {k: seed for k, seed in enumerate(seeds) if seed is not None and in_conflict[k]}
        if not chosen:
            return cuts
        given = np.isin(self.swarm, list(chosen))
        self.reference.set(given, self._propagated(np.concatenate(list(chosen.values())), given))
        near, bound = self.task.detection.conflicts(
            self.reference,
            self.problem.collision_radius + min(self.problem.collision_radius, SEED_LOOK),
            given,
            spread=self.settings.cut_spread,
        )
        controls = self.reference.controls
        too_strong = self._exceeding_limits(controls)
        unfit = near.first[bound <= self.provable], np.flatnonzero(too_strong)
        safe = np.zeros(len(self.batch.scenarios), dtype=bool)
        safe[list(chosen)] = True
        safe[self.swarm[np.concatenate(unfit)]] = False
        self.incumbents.update(controls, safe)
        return cuts + near

    def _first_shift(self, start: int) -> Vectors | float:
        """Random shifts of the relative positions about which the first cuts are linearized.

        Each cut has its own; after a loss of thrust, where a pair has many cuts, all of a pair have
        the same in every other start. Some scenarios are solved with the one kind of shifts alone,
        some with the other.
        """
        if not start:
            return 0.0
        of_pairs = self.task.requirements.passive_safety is not None and start % 2 == 1
        shift = np.zeros((len(self.cuts), 3))
        for of_swarm in groups(self.swarm[self.cuts.first]):
            rng, which = np.random.default_rng(start), np.arange(len(of_swarm))
            if of_pairs:
                ends = np.stack([self.cuts.first[of_swarm], self.cuts.second[of_swarm]])
                which = np.unique(ends, axis=1, return_inverse=True)[1].ravel()
            scale = self.problem.collision_radius * SHIFT
            shift[of_swarm] = rng.normal(scale=scale, size=(which.max() + 1, 3))[which]
        return shift

    def _stuck(self) -> Bool[Array, "scenarios"]:
        """Mask of the scenarios with a cluster whose slack has stayed the same for too long."""
        return self._scenarios(self.stalled >= STALLED)

    def run(self) -> list[SearchResult]:
        """Solve and check until every cluster is done."""
        most = self.settings.max_rounds
        if self.task.requirements.passive_safety is not None:
            most = min(most, MOST_ROUNDS_PASSIVE)
        for _ in range(most):
            going = self.active & ~self._stuck()[self.swarm]
            if not going.any():
                break
            self.incumbents.begin_round(going)
            clusters = self._solve(self._clusters(going))
            if clusters:
                self._check(clusters)
        kept = self.accepted & (self.active | self.failed)
        self.iterate.controls[kept] = self.reference.controls[kept]
        return self.incumbents.results(self.iterate.controls, self.cuts, self.active & ~kept)

    def _exceeding_limits(self, controls: Controls) -> CraftMask:
        """Mask of the craft whose controls exceed their limits."""
        if self.batch.limits is None:
            return np.abs(controls).max(axis=(1, 2)) > control_limit(self.problem)
        found = exceeded_limits(controls, self.batch.limits, self.problem)
        return np.asarray(np.any([*found.values()], axis=0))

    def _propagated(self, controls: Controls, craft: Cluster | Bool[Array, "_"]) -> Trajectory:
        initial, goal, batch = self.batch.initial[craft], self.batch.goal[craft], self.batch
        if batch.limits is None or batch.constraints is None:
            exact = meet_goal(initial, controls, goal, self.problem)
        else:
            at, limits = batch.constraints[craft], batch.limits[craft]
            exact = polished(controls, at, limits, self.problem)
        return Trajectory(exact, fly(initial, exact, self.problem))

    def _objective(self, flown: Trajectory, craft: Cluster) -> float:
        """The objective of a cluster's trajectory, m/s²."""
        return self.batch.objective(flown.controls[craft], craft)

    def _set_cuts(self, cuts: Cuts) -> None:
        self.cuts = cuts
        beyond, radius = cuts.beyond[len(self.dual) :], self.problem.collision_radius
        margin = self.settings.margin_at(radius + np.minimum(beyond, 0.0))
        self.separation = np.append(self.separation, radius + margin)
        self.back_off = np.append(self.back_off, beyond)
        self.dual = np.append(self.dual, np.zeros(len(beyond)))
        # The cluster of each craft, and the cuts of each cluster.
        self.labels = cluster_labels(len(self.swarm), cuts.first, cuts.second)
        label = self.labels[cuts.first]
        self.cuts_of = {int(label[one[0]]): one for one in groups(label)}

    def _raise_back_off(self, flown: Trajectory) -> None:
        """Raise back-offs to those of a trajectory; they never fall, or the search might cycle."""
        needed = self.task.detection.back_off_of(self.cuts, flown)
        self.back_off = np.maximum(self.back_off, needed)

    def _clusters(self, touched: CraftMask) -> list[Cluster]:
        there = np.zeros(len(self.labels), dtype=bool)
        there[self.labels[touched]] = True
        craft = np.flatnonzero(there[self.labels])
        return [craft[one] for one in groups(self.labels[craft])]

    def _distances(self, flown: Trajectory) -> Values:
        """Separation of each cut's pair in a trajectory, less its back-off, m."""
        distance = norm(gaps(self.cuts, flown.states, flown.controls))
        return distance - self.task.detection.back_off_of(self.cuts, flown)

    def _solve(self, clusters: list[Cluster]) -> list[Cluster]:
        """Solve each cluster's program, with all cuts linearized about the reference.

        Returns the clusters that did not fail. Where the solver fails, or a safe iterate is known
        and the program's optimum is no cheaper, the cluster is done and keeps its iterate.
        """
        self._raise_back_off(self.reference)
        normal = normals(self.cuts, self.reference.states, self.reference.controls, self.shift)
        self.shift = 0.0  # for the first program alone
        planes = half_spaces(
            self.cuts, normal, self.batch.initial, self.problem, self.separation + self.back_off
        )
        # By an interior-point method, the optimum of a cluster would depend on those beside it.
        separate = self.batch.limits is not None or self.settings.solver != "simplex"
        alone = [[craft] for craft in clusters]
        for some in alone if separate else joint_clusters(clusters, self.swarm):
            self._solve_jointly(some, planes)
        for craft in clusters:
            if self.accepted[craft].all():
                new, best = (self._objective(one, craft) for one in (self.iterate, self.reference))
                if new >= best:
                    self._return_to_reference(craft)
        moved = np.concatenate(clusters)
        self.iterate.set(moved, self._propagated(self.iterate.controls[moved], moved))
        return [craft for craft in clusters if not self.failed[craft].any()]

    def _solve_jointly(self, clusters: list[Cluster], planes: HalfSpaces) -> None:
        """Solve several clusters as one program or, where that fails, each by its own program."""
        if len(clusters) > 1:
            cuts = np.concatenate([self.cuts_of[int(craft[0])] for craft in clusters])
            with suppress(UnsolvableError):
                self._solve_whole(np.sort(np.concatenate(clusters)), np.sort(cuts), planes)
                return
        for craft in clusters:
            try:
                self._solve_cluster(craft, planes)
            except UnsolvableError as error:
                self._fail(craft, str(error))

    def _solve_cluster(self, craft: Cluster, planes: HalfSpaces) -> None:
        """Solve a cluster's program or, of a large one, parts that grow where they leave slack."""
        cuts, near = self.cuts_of[int(craft[0])], self.unsafe
        if self.task.whole_burns and len(craft) > FEW:
            for k in range(len(craft)):
                self._solve_part(craft[k : k + 1], cuts, planes)
            return
        # The largest share depends on all craft.
        divisible = len(craft) >= VAST and self.batch.weight is None
        for _ in range(2):
            parts = neighbourhoods(craft, self.cuts[cuts], near) if divisible else []
            if not parts:
                self._solve_whole(craft, cuts, planes)
                return
            tight = [part for part in parts if self._solve_part(part, cuts, planes)]
            if not tight:
                return
            near = np.zeros(len(self.swarm), dtype=bool)
            near[np.concatenate(tight)] = True

    def _solve_whole(self, craft: Cluster, cuts: Int[Array, "_"], planes: HalfSpaces) -> None:
        """Solve one program with all craft and cuts of a cluster, or of several clusters."""
        ends = self.cuts.first[cuts], self.cuts.second[cuts]
        i, j = (np.searchsorted(craft, end) for end in ends)
        best = self._optimum(craft, i, j, planes[cuts], self.bases.last(craft, cuts))
        self.bases.keep(craft, cuts, best)
        self._keep(craft, cuts, best)

    def _solve_part(self, craft: Cluster, cuts: Int[Array, "_"], planes: HalfSpaces) -> bool:
        """Solve the subproblem of some craft of a cluster; whether it leaves slack."""
        free = np.zeros(len(self.swarm), dtype=bool)
        free[craft] = True
        cuts = cuts[free[self.cuts.first[cuts]] | free[self.cuts.second[cuts]]]
        fixed = with_others_fixed(craft, self.cuts[cuts], planes[cuts], self.iterate.controls)
        best = self._optimum(craft, *fixed)
        self._keep(craft, cuts, best)
        return float(best.slack.max()) > SLACK_TOLERANCE

    def _keep(self, craft: Cluster, cuts: Int[Array, "_"], best: Optimum) -> None:
        """Make a program's optimum the newest iterate of its craft, and note duals and slack."""
        self.iterate.controls[craft] = best.controls.reshape(len(craft), -1, 3)
        self.dual[cuts] = best.dual
        k = int(best.slack.argmax())
        i, j = self.cuts.first[cuts[k]], self.cuts.second[cuts[k]]
        self.incumbents.note_slack(int(i), int(j), float(best.slack[k]))
        if self.task.requirements.passive_safety is not None:
            self._note_stalling(craft, cuts, best.slack)

    def _note_stalling(self, craft: Cluster, cuts: Int[Array, "_"], slack: Values) -> None:
        """Count, for each cluster, consecutive rounds with the same largest slack."""
        largest = np.zeros(len(self.swarm))
        np.maximum.at(largest, self.labels[self.cuts.first[cuts]], slack)
        now, before = largest[self.labels[craft]], self.slack[craft]
        same = (now > SLACK_TOLERANCE) & (np.abs(now - before) <= SAME * now)
        self.stalled[craft] = np.where(same, self.stalled[craft] + 1, 0)
        self.slack[craft] = now

    def _optimum(
        self,
        craft: Cluster,
        first: Indices,
        second: Indices,
        planes: HalfSpaces,
        last: Basis | None = None,
    ) -> Optimum:
        """Solve one program; craft of half-spaces are given by their indices in it."""
        batch, basis = self.batch, self.batch.optima.basis
        sub = Subproblem(
            reach=transfer_maps(self.problem).reach[-1],
            miss=self.batch.miss[craft],
            first=first,
            second=second,
            **vars(planes),
            limit=control_limit(self.problem),
            penalty=PENALTY / self.problem.time_step**2,
            unit=float(self.batch.unit[self.swarm[craft[0]]]),
            basis=None if basis is None else basis[craft],
            last=last,
        )
        if batch.limits is None or batch.constraints is None:
            return by_simplex(sub) if self.settings.solver == "simplex" else by_cones(sub)
        weight, at = batch.weight, batch.constraints[craft]
        general = replace(
            sub,
            reach=at.reach,
            miss=at.miss,
            constrained=at.constrained,
            rounding=at.rounding,
            thrust=self.problem.thrust,
            time_step=self.problem.time_step,
            limits=program_limits(batch.limits[craft]),
            weight=None if weight is None else weight[craft],
        )
        if self.task.whole_burns:
            from pipeline.expert.mixed_integer import by_integers  # by SciPy, slow to import

            return by_integers(general)
        return by_cones(general)

    def _return_to_reference(self, craft: Cluster) -> None:
        """End a cluster's search with its safe iterate, which is checked again, as others moved."""
        self.iterate.controls[craft] = self.reference.controls[craft]
        self.active[craft] = False

    def _fail(self, craft: Cluster, why: str) -> None:
        """End the search of a cluster that failed, with its safe iterate if it has one."""
        self.incumbents.note_failure(int(craft[0]), why)
        if self.accepted[craft].all():
            self._return_to_reference(craft)
        else:
            self.active[craft], self.failed[craft] = False, True

    def _check(self, clusters: list[Cluster]) -> None:
        """Accept clusters whose new iterate has no conflicts, and add cuts to the others."""
        moved = self._moved(clusters)
        within = self.settings.cut_distance(self.problem.collision_radius)
        found, bound = self.task.detection.conflicts(self.iterate, within, moved)
        broken = bound <= self.provable  # so that the certificate proves the rest safe
        unsafe = np.zeros(len(self.swarm), dtype=bool)
        unsafe[found.first[broken]] = unsafe[found.second[broken]] = True
        self.unsafe = unsafe
        safe = [one for one in clusters if self.active[one].any() and not unsafe[one].any()]
        predicted = self._predicted_gains() if safe else np.zeros(0)
        for craft in safe:
            self._accept(craft, float(predicted[craft[0]]))
        # Scenarios that are stuck are not checked again, so none of their craft is found unsafe.
        wrong = self._scenarios(unsafe | self.failed) | self._stuck()
        self.incumbents.update(self.iterate.controls, ~wrong)
        if broken.any():
            again = self._scenarios(found.first[broken])[self.swarm[found.first]]
            self._set_cuts(self.cuts + found[again & (self.active[found.first] | broken)])
            self._raise_back_off(self.iterate)
            self._choose_reference(unsafe)

    def _moved(self, clusters: list[Cluster]) -> CraftMask:
        """Mask of the craft whose pairs are checked again: those of clusters that moved.

        In large clusters only craft that changed since their last check, and unsafe ones.
        """
        moved = np.zeros(len(self.swarm), dtype=bool)
        moved[np.concatenate(clusters)] = True
        for craft in clusters:
            if len(craft) >= LARGE:
                change = np.abs(self.iterate.controls[craft] - self.checked[craft]).max(axis=(1, 2))
                stays = change <= STILL * self.batch.unit[self.swarm[craft[0]]]
                moved[craft[stays & ~self.unsafe[craft]]] = False
        self.checked[moved] = self.iterate.controls[moved]
        return moved

    def _predicted_gains(self) -> Float[Array, "n"]:
        """First-order estimate of the gain of each cluster by linearizing about the newest iterate.

        A cut kept the separation along its old normal; the pair's distance exceeds it by a surplus,
        and a metre of that gains the cut's dual variable.
        """
        surplus = self._distances(self.iterate) - self.separation
        gain = self.dual * np.maximum(surplus, 0.0)
        return np.bincount(self.labels[self.cuts.first], gain, len(self.swarm))

    def _accept(self, craft: Cluster, predicted: float) -> None:
        """Linearize about a safe iterate from now on; done where little gain is predicted."""
        settings, fuel = self.settings, self._objective(self.iterate, craft)
        before = self._objective(self.reference, craft)
        gained = before - fuel if self.accepted[craft].all() else np.inf
        self.reference.set(craft, self.iterate[craft])
        self.accepted[craft], self.stalled[craft] = True, 0
        bound = self.batch.objective_of(self.batch.optima.lower_bound[craft], craft)
        gap = gap_of(fuel, bound, self.problem)
        self.active[craft] = not (
            settings.stop == "first-safe"
            or gap <= settings.gap_tolerance
            or min(gained, predicted) <= settings.improvement * fuel
        )

    def _choose_reference(self, unsafe: CraftMask) -> None:
        """Keep linearization points that satisfy all their cuts; move others to the iterate."""
        broken = self._distances(self.reference) <= self.problem.collision_radius
        moving = self.labels[self.cuts.first[broken]]
        for craft in self._clusters(unsafe):
            self.active[craft], self.failed[craft] = True, False
            if craft[0] in moving:
                self.reference.set(craft, self.iterate[craft])
                self.accepted[craft] = False
