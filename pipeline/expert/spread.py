"""Separation asked for because craft are not quite where they are planned to be."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float

from pipeline.arrays import Array
from pipeline.expert.cuts import Cuts, conflicts, directions, gaps
from pipeline.orbit.approaches import PROVABLE, Swarms
from pipeline.orbit.covariance import Uncertainty, deviation_along, dispersion
from pipeline.orbit.problem import Problem
from pipeline.orbit.risk import levels_at
from pipeline.plan import Requirements

ENDS = 2 * PROVABLE
"""What pairs have left beyond what is asked for at the ends, where no control can move them, m."""


@dataclass(frozen=True)
class Spread:
    """So many standard deviations of each pair's separation are kept beyond the collision radius.

    No pair is asked for more of them than its own ends have: at the start throughout the first
    interval, at the goal throughout the last.

    Attributes:
        uncertainty: what is not known of the initial states, and not done as planned.
        sigmas: how many standard deviations, along the line between the two craft.
    """

    uncertainty: Uncertainty
    sigmas: float

    def most(self, controls: Float[Array, "n intervals 3"], problem: Problem) -> float:
        """No pair is asked for more than this besides the collision radius, m."""
        deviation = dispersion(controls, problem, self.uncertainty).most_deviation(problem)
        return self.sigmas * 2**0.5 * float(deviation.max())

    def widths(
        self,
        cuts: Cuts,
        states: Float[Array, "n T 6"],
        controls: Float[Array, "n intervals 3"],
        problem: Problem,
        margin: float,
    ) -> Float[Array, "k"]:
        """What each cut asks for besides the collision radius and a margin, m.

        A cut about a craft that has lost its thrust asks for nothing besides.

        Args:
            cuts: pairs and times.
            states: node states, m and m/s.
            controls: m/s²; the errors of these burns are meant.
            problem: the problem.
            margin: asked for besides, m.
        """
        if cuts.apart is not None:
            found, flying = np.zeros(len(cuts)), cuts.in_flight
            both = replace(cuts.where(flying), apart=None)
            found[flying] = self.widths(both, states, controls, problem, margin)
            return found
        spread = dispersion(controls, problem, self.uncertainty)
        i, j, k = cuts.first, cuts.second, cuts.interval
        normal = directions(gaps(cuts, states, controls), states[i, k, 3:] - states[j, k, 3:])
        deviation = deviation_along(normal, (cuts.free, cuts.pushed), spread.of_pairs(i, j, k))
        sigmas = np.full(len(cuts), self.sigmas)
        kept = problem.collision_radius + margin + ENDS
        for node, interval in ((0, 0), (problem.intervals, problem.intervals - 1)):
            at = np.flatnonzero(k == interval)
            most = levels_at(node, i[at], j[at], states, spread, kept)
            sigmas[at] = np.clip(most, 0.0, sigmas[at])
        return sigmas * deviation


def conflicts_less(
    spread: Spread | None,
    states: Float[Array, "n T 6"],
    controls: Float[Array, "n intervals 3"],
    problem: Problem,
    within: float,
    moved: Bool[Array, "n"],
    *,
    margin: float,
    requirements: Requirements,
    swarms: Swarms | None = None,
    beside: float = 0.0,
) -> tuple[Cuts, Float[Array, "k"]]:
    """``conflicts``, with what a spread asks for taken off every distance.

    Args:
        spread: None for none.
        states: node states, m and m/s.
        controls: m/s².
        problem: the problem.
        within: distance of interest besides what the spread asks for, m.
        moved: craft whose pairs are looked at.
        margin: asked for besides, m.
        requirements: as in ``conflicts``; so are the rest.
        swarms: which craft belong together.
        beside: also cut so long before and after.
    """
    look = partial(conflicts, states, controls, problem, moved=moved, requirements=requirements)
    if spread is None:
        return look(within=within, swarms=swarms, beside=beside)
    most = spread.most(controls, problem)
    cuts, bound = look(within=within + most, swarms=swarms, beside=beside)
    bound = bound - spread.widths(cuts, states, controls, problem, margin)
    near = bound <= within
    return cuts.where(near), bound[near]
