"""Which share of a plan's error comes from what: flown again with one effect more each time."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.errors import InputError
from pipeline.flight.conditions import Conditions
from pipeline.flight.flight import Flight, fly_controls
from pipeline.flight.world import LinearWorld, World
from pipeline.orbit.bezier import norm
from pipeline.orbit.reference import radius_at
from pipeline.orbit.transfer import fly
from pipeline.scenario import Scenario

PLAN = "plan"
"""Of the effects' names: the linear model, in which the plan was made."""

FURTHEST = 0.01
"""Distance from the origin in radii of the reference orbit, within which plans are flown."""


@dataclass(frozen=True, eq=False)
class Effect:
    """A flight with one effect more than the one before.

    Attributes:
        name: "plan", in the linear model; then "curvature", "eccentricity", "J2", "drag".
        flight: with it and all before it.
        errors: what each craft's state misses its goal's by, (n, 6), m and m/s.
        added: what of that was not there without it, (n, 6); all effects' sum to the last errors.
        share: of the last error in position of the craft that misses its goal by most: what was
            added to its, along it. Shares sum to 1; below 0, the effect takes back what others do.
    """

    name: str
    flight: Flight
    errors: Float[Array, "n 6"]
    added: Float[Array, "n 6"]
    share: float


def effects(
    scenario: Scenario, controls: Float[Array, "n intervals 3"], conditions: Conditions
) -> list[Effect]:
    """Fly a plan's controls (m/s²) with one effect more each time, up to all of the conditions.

    Effects are added in this order: curvature, two bodies on a circular orbit instead of the
    linear model; eccentricity; J2; drag. What each adds depends on the order by products of two
    effects, which are small. Those that the conditions lack are left out.

    Raises:
        InputError: where the controls lead too far away, or for conditions without a world.
    """
    problem, goal = scenario.problem, scenario.goal
    refuse_distance(scenario, controls)
    worlds = [(PLAN, LinearWorld(problem.dynamics)), *_worlds(scenario, conditions)]
    flights = [fly_controls(world, scenario.initial, controls, problem) for _, world in worlds]
    errors = np.stack([flight.states[:, -1] - goal for flight in flights])
    added = np.diff(errors, axis=0, prepend=np.zeros((1, *goal.shape)))
    worst = int(norm(errors[-1, :, :3]).argmax())
    last = errors[-1, worst, :3]
    shares = np.vecdot(added[:, worst, :3], last) / max(float(last @ last), np.finfo(float).tiny)
    return [
        Effect(name, *rest)
        for (name, _), *rest in zip(worlds, flights, errors, added, shares.tolist(), strict=True)
    ]


def _worlds(scenario: Scenario, conditions: Conditions) -> Iterator[tuple[str, World]]:
    """Worlds by the effect that is new in each."""
    bare = replace(conditions, eccentricity=0.0, j2=False, ballistic=None)
    eccentric = replace(bare, eccentricity=conditions.eccentricity)
    oblate = replace(eccentric, j2=conditions.j2)
    steps = (
        ("curvature", bare, True),
        ("eccentricity", eccentric, conditions.eccentricity > 0),
        ("J2", oblate, conditions.j2),
        ("drag", conditions, conditions.ballistic is not None),
    )
    for name, one, present in steps:
        if present:
            yield name, one.world(scenario.problem, scenario.n)


def refuse_distance(scenario: Scenario, controls: Float[Array, "n intervals 3"]) -> None:
    """Refuse controls (m/s²) that lead too far away; written so that what is no number is refused.

    Raises:
        InputError: naming the craft, and how far.
    """
    problem = scenario.problem
    with np.errstate(over="ignore", invalid="ignore"):
        far = norm(fly(scenario.initial, controls, problem)[..., :3]).max(axis=1)
    most = FURTHEST * radius_at(problem.mean_motion)
    bad = ~(far <= most)
    if bad.any():
        craft = int(bad.argmax())
        raise InputError(
            f"the controls lead craft {craft} {far[craft]:.3g} m away from the reference orbit's "
            f"point; expected at most {most:.3g} m, {FURTHEST:.0%} of that orbit's radius."
        )
