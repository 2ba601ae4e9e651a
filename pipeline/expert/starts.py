"""Several starts: passing on other sides, for a plan at all or for the best of each cluster."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.expert.batch import Batch
from pipeline.expert.clusters import cluster_labels
from pipeline.expert.losses import conflicts_asked_about
from pipeline.expert.own import OwnOptima
from pipeline.expert.scp import Search
from pipeline.expert.settings import Settings
from pipeline.expert.spread import Spread
from pipeline.expert.standing import Found
from pipeline.orbit.approaches import PROVABLE
from pipeline.orbit.transfer import fly
from pipeline.plan import Requirements, gap_of
from pipeline.scenario import Scenario


def until_settled(
    batch: Batch,
    own: OwnOptima,
    first: Sequence[Found],
    settings: Settings,
    requirements: Requirements,
    spread: Spread | None = None,
) -> list[Found]:
    """What first searches found, and ``settings.again`` further ones at most where that is unsafe.

    Craft in one plane are aimed apart in that plane, where there may be no way past one adrift;
    other sides lead out of it.
    """
    found = list(first)
    for start in range(1, settings.again + 1):
        left = [k for k, one in enumerate(found) if not one.settled]
        if not left:
            break
        theirs = own.of(np.isin(batch.swarms.label, left))
        others = Search(batch.part(left), theirs, settings, requirements, None, start, spread).run()
        for k, other in zip(left, others, strict=True):
            solves = found[k].convex_solves + other.convex_solves
            found[k] = replace(other if other.settled else found[k], convex_solves=solves)
    return found


def best_of_starts(
    batch: Batch,
    own: OwnOptima,
    first: Sequence[Found],
    settings: Settings,
    requirements: Requirements,
    spread: Spread | None = None,
) -> list[Found]:
    """What first searches found, bettered by ``settings.starts`` - 1 further ones.

    The sides on which craft pass each other decide which local optimum a search ends in. Each
    further start draws them anew, the same way every time.
    """
    best, bounds = list(first), [float(part.sum()) for part in batch.split(own.lower_bound)]
    for start in range(1, settings.starts):
        left = [
            k
            for k, (found, bound) in enumerate(zip(best, bounds, strict=True))
            if gap_of(float(np.abs(found.controls).sum()), bound, batch.problem)
            > settings.gap_tolerance
        ]
        if not left:
            break
        theirs = own.of(np.isin(batch.swarms.label, left))
        others = Search(batch.part(left), theirs, settings, requirements, None, start, spread).run()
        for k, other in zip(left, others, strict=True):
            solves = best[k].convex_solves + other.convex_solves
            better = _better(batch.scenarios[k], best[k], other, settings, requirements, spread)
            best[k] = replace(better, convex_solves=solves)
    return best


def _better(
    scenario: Scenario,
    best: Found,
    other: Found,
    settings: Settings,
    requirements: Requirements,
    spread: Spread | None,
) -> Found:
    """The cheaper of both in every cluster, where that is safe; else the cheaper of both."""
    if not (best.settled and other.settled):
        return best if best.settled else other
    both = np.concatenate([best.joined, other.joined])
    labels = cluster_labels(scenario.n, *both.T)
    saved = np.abs(best.controls).sum(axis=(1, 2)) - np.abs(other.controls).sum(axis=(1, 2))
    cheaper = (np.bincount(labels, saved, scenario.n) > 0)[labels]
    controls = np.where(cheaper[:, None, None], other.controls, best.controls)
    states = fly(scenario.initial, controls, scenario.problem)
    radius = scenario.problem.collision_radius + PROVABLE
    everyone = np.ones(scenario.n, dtype=bool)
    found, _ = conflicts_asked_about(
        states,
        controls,
        scenario.problem,
        radius,
        everyone,
        requirements,
        margin=settings.margin,
        spread=spread,
    )
    if len(found) == 0:
        return replace(best, controls=controls, joined=both)
    return other if saved.sum() > 0 else best
