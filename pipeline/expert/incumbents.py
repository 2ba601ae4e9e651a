"""Incumbents of a search: each scenario's cheapest safe iterate, or why there is none."""

from dataclasses import dataclass, field

import numpy as np

from pipeline.arrays import Array, Bool, Int
from pipeline.expert.batch import Batch
from pipeline.expert.cuts import Cuts
from pipeline.orbit.arrays import Controls, CraftMask, PerCraft

SLACK_TOLERANCE = 1e-5  # slack, m, below which a half-space counts as satisfied


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Result of the search for a plan of a scenario."""

    controls: Controls  # m/s²
    convex_solves: int = 0  # rounds of programs, the clusters of a round counted as one
    # pairs of craft that cuts were made for
    joined: Int[Array, "k 2"] = field(default_factory=lambda: np.zeros((0, 2), dtype=int))
    feasible: bool = False  # whether the controls were found safe as a whole
    obstacle: str = ""  # reason why there is no safe plan, or empty
    infeasible: bool = False  # whether it is proven to exclude every plan
    fuel_without: float | None = None  # of the plan that ignores the smallest burn, m/s²
    lower_bound: PerCraft | None = None  # on the fuel by burns as large as the smallest, m/s²


class Incumbents:
    """Cheapest safe iterate, rounds and failures of each scenario of a batch."""

    def __init__(self, batch: Batch, controls: Controls) -> None:
        self._batch, self._swarm = batch, batch.swarms.label
        self._cheapest = np.full(len(batch.scenarios), np.inf)
        self._best = controls.copy()
        self._rounds = np.zeros(len(batch.scenarios), dtype=int)
        self._failure: dict[int, str] = {}
        self._slack: dict[int, tuple[float, int, int]] = {}

    def begin_round(self, active: CraftMask) -> None:
        """Count a round for scenarios with active craft, and delete their slack of the last one."""
        going = np.bincount(self._swarm[active], minlength=len(self._rounds)) > 0
        self._rounds += going
        self._slack = {k: slack for k, slack in self._slack.items() if not going[k]}

    def update(self, controls: Controls, safe: Bool[Array, "swarms"]) -> None:
        """Keep iterates of scenarios that are safe as a whole and cheaper than any before."""
        batch = self._batch
        if not safe.any():
            return
        if batch.limits is None:
            fuel = np.add.reduceat(np.abs(controls).sum(axis=(1, 2)), batch.swarms.starts)
        else:
            fuel = np.array([batch.objective(controls[craft], craft) for craft in batch.craft])
        better = safe & (fuel < self._cheapest)
        self._cheapest[better] = fuel[better]
        self._best[better[self._swarm]] = controls[better[self._swarm]]

    def note_failure(self, craft: int, why: str) -> None:
        """Note why the solver failed."""
        self._failure[int(self._swarm[craft])] = why

    def note_slack(self, first: int, second: int, slack: float) -> None:
        """Note a pair that a program leaves too close; the largest slack of a round is kept."""
        swarm = int(self._swarm[first])
        self._slack[swarm] = max(self._slack.get(swarm, (0.0, 0, 0)), (slack, first, second))

    def results(self, controls: Controls, cuts: Cuts, left: CraftMask) -> list[SearchResult]:
        """Incumbents, or else the newest controls, m/s²; craft in ``left`` are unfinished."""
        feasible, starts = np.isfinite(self._cheapest), self._batch.swarms.starts
        ended = np.where(feasible[self._swarm, None, None], self._best, controls)
        joined = np.array([cuts.first, cuts.second]).T
        return [
            SearchResult(
                controls=part,
                convex_solves=int(self._rounds[k]),
                joined=joined[self._swarm[cuts.first] == k] - starts[k],
                feasible=bool(feasible[k]),
                obstacle="" if feasible[k] else self._obstacle(k, left=k in self._swarm[left]),
            )
            for k, part in enumerate(self._batch.swarms.split(ended))
        ]

    def _obstacle(self, swarm: int, *, left: bool) -> str:
        """Why the solver failed, or the pair that the last program could not keep apart."""
        if swarm in self._failure:
            return self._failure[swarm]
        slack, i, j = self._slack.get(swarm, (0.0, 0, 0))
        if not left or slack < SLACK_TOLERANCE:
            return ""
        start, radius = self._batch.swarms.starts[swarm], self._batch.problem.collision_radius
        if i == j or self._batch.unlike:
            pair = f"{i - start}" if i == j else f"{i - start} and {j - start}"
            return f"the last program could not keep craft {pair} clear, {slack:.3g} m are missing"
        return (
            f"the last program could not keep craft {i - start} and {j - start} {radius:g} m "
            f"apart, {slack:.3g} m are missing"
        )
