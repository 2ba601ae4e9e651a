"""What a search knows of each scenario: its cheapest safe iterate, or what stands in the way."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.arrays import Array
from pipeline.expert.batch import Batch
from pipeline.expert.cuts import Cuts

SLACK_TOLERANCE = 1e-5
"""Slack in m under which a half-space counts as met."""


@dataclass(frozen=True, eq=False)
class Found:
    """What the search of a scenario ended with.

    Attributes:
        controls: (n, T-1, 3), m/s².
        convex_solves: rounds of programs, the clusters of a round counted as one.
        joined: pairs of craft that cuts were made for, (k, 2).
        settled: whether the controls were seen to be safe as a whole.
        obstacle: what stood in the way of a safe plan, or nothing.
        hopeless: whether it is proven to stand in the way of every plan.
    """

    controls: Float[Array, "n intervals 3"]
    convex_solves: int = 0
    joined: Int[Array, "k 2"] = field(default_factory=lambda: np.zeros((0, 2), dtype=int))
    settled: bool = False
    obstacle: str = ""
    hopeless: bool = False


class Standing:
    """Of each scenario, by its number in the batch.

    Attributes:
        rounds: rounds of programs so far.
    """

    def __init__(self, batch: Batch, controls: Float[Array, "n intervals 3"]) -> None:
        self._batch, self._swarm = batch, batch.swarms.label
        self._cheapest = np.full(len(batch.scenarios), np.inf)
        self._best = controls.copy()
        self._failure: dict[int, str] = {}
        self._slack: dict[int, tuple[float, int, int]] = {}
        self.rounds = np.zeros(len(batch.scenarios), dtype=int)

    def begin_round(self, active: Bool[Array, "n"]) -> None:
        """Count a round of the scenarios of some craft; only its own slack is remembered."""
        self.rounds[np.unique(self._swarm[active])] += 1
        self._slack = {}

    def remember(
        self, controls: Float[Array, "n intervals 3"], safe: Bool[Array, "swarms"]
    ) -> None:
        """Keep iterates that are safe as a whole and cheaper than any before."""
        fuel = np.add.reduceat(np.abs(controls).sum(axis=(1, 2)), self._batch.swarms.starts)
        better = safe & (fuel < self._cheapest)
        self._cheapest[better] = fuel[better]
        self._best[better[self._swarm]] = controls[better[self._swarm]]

    def fail(self, craft: int, why: str) -> None:
        """Note what the solver failed at."""
        self._failure[int(self._swarm[craft])] = why

    def note_slack(self, first: int, second: int, slack: float) -> None:
        """Note a pair that a program leaves too close; the closest of a round counts."""
        swarm = int(self._swarm[first])
        self._slack[swarm] = max(self._slack.get(swarm, (0.0, 0, 0)), (slack, first, second))

    def found(
        self, controls: Float[Array, "n intervals 3"], cuts: Cuts, left: Bool[Array, "n"]
    ) -> list[Found]:
        """What each scenario ends with: its cheapest safe iterate, or else the controls given.

        Args:
            controls: the newest ones.
            cuts: all that were made.
            left: craft that are neither done nor safe.
        """
        settled, starts = np.isfinite(self._cheapest), self._batch.swarms.starts
        ended = np.where(settled[self._swarm, None, None], self._best, controls)
        joined = np.array([cuts.first, cuts.second]).T
        left_over = np.isin(np.arange(len(settled)), self._swarm[left])
        return [
            Found(
                controls=part,
                convex_solves=int(self.rounds[k]),
                joined=joined[self._swarm[cuts.first] == k] - starts[k],
                settled=bool(settled[k]),
                obstacle="" if settled[k] else self._obstacle(k, left=bool(left_over[k])),
            )
            for k, part in enumerate(self._batch.split(ended))
        ]

    def _obstacle(self, swarm: int, *, left: bool) -> str:
        """What the solver failed at, or the pair that no program could hold apart."""
        if swarm in self._failure:
            return self._failure[swarm]
        slack, i, j = self._slack.get(swarm, (0.0, 0, 0))
        if not left or slack < SLACK_TOLERANCE:
            return ""
        start, radius = self._batch.swarms.starts[swarm], self._batch.problem.collision_radius
        return (
            f"the last program could not keep craft {i - start} and {j - start} {radius:g} m "
            f"apart, {slack:.3g} m are missing"
        )
