"""Lower bounds on the fuel of craft in corridors, and proofs that they cannot stay inside.

A corridor is convex: at any one time each of its faces is a half-space of the controls. So a craft
has a convex program of its own, with the faces and times at which the last program's controls lead
farthest outside. By weak duality each of these programs proves a bound.
"""

from dataclasses import replace

import numpy as np

from pipeline.expert.conic_decoupled import dual_bounds, minimum_fuel_by_cones, proven_infeasible
from pipeline.expert.cuts import Cuts, HalfSpaces, SecondCraft, half_spaces
from pipeline.orbit.arrays import Controls, CraftMask, Formation, PerCraft
from pipeline.orbit.corridors import Faces, Margins, margins
from pipeline.orbit.problem import LIMIT_ROUNDING, Problem
from pipeline.orbit.thrust import Limits
from pipeline.orbit.transfer import fly
from pipeline.scenario.state_constraints import StateConstraints

OUTSIDE = 1e-4  # distance outside of a corridor from which a half-space is added, m
ROUNDS = 20  # programs of a craft at most


def corridor_bounds(
    initial: Formation,
    controls: Controls,
    at: StateConstraints,
    limits: Limits,
    problem: Problem,
    faces: Faces,
) -> tuple[PerCraft, CraftMask]:
    """Lower bound on the fuel of each craft, m/s², and which provably cannot stay inside.

    The controls are those of decoupled optima. The bound is 0 for craft that stay inside of their
    corridors by these, or of which nothing is proven.
    """
    bound, impossible = np.zeros(len(initial)), np.zeros(len(initial), dtype=bool)
    outside = _outside(initial, controls, problem, faces)
    for k in np.unique(faces.craft[outside.face]).tolist():
        one, its = slice(k, k + 1), faces[faces.craft == k]
        its = replace(its, craft=np.zeros_like(its.craft))
        alone = initial[one], controls[one], at[one], limits[one], problem, its
        bound[k], impossible[k] = _bound_of_one(*alone)
    dear = bound * problem.time_step > limits.delta_v * (1 + LIMIT_ROUNDING)
    return bound, impossible | dear


def _bound_of_one(
    initial: Formation,
    controls: Controls,
    at: StateConstraints,
    limits: Limits,
    problem: Problem,
    faces: Faces,
) -> tuple[float, bool]:
    """As ``corridor_bounds``, for a single craft."""
    found: Controls | None = controls
    bound, known = 0.0, []
    for _ in range(ROUNDS):
        assert found is not None
        outside = _outside(initial, found, problem, faces)
        if len(outside) == 0:
            break
        known.append(_inside(outside, faces, initial, problem))
        inside = HalfSpaces.concatenated(known)
        found, duals = minimum_fuel_by_cones(at, limits, problem, inside)
        if found is None:
            return bound, proven_infeasible(duals, at, limits, problem)
        bound = max(bound, float(dual_bounds(duals, limits, problem)[0]))
    return bound, False


def _outside(initial: Formation, controls: Controls, problem: Problem, faces: Faces) -> Margins:
    """Where controls lead craft farthest outside of each face in each interval."""
    found = margins(fly(initial, controls, problem), controls, problem, faces)
    return found[found.margin < -OUTSIDE]


def _inside(outside: Margins, faces: Faces, initial: Formation, problem: Problem) -> HalfSpaces:
    """Half-spaces of the controls of a single craft that lead inside faces at these times."""
    craft, still = np.zeros((2, len(outside)), dtype=int)
    nowhere = SecondCraft(
        still,
        np.zeros_like(outside.state_map),
        np.zeros_like(outside.control_map),
        np.zeros((len(outside), 3)),
    )
    maps = outside.state_map, outside.control_map
    cuts = Cuts(craft, craft, outside.interval, *maps, other=nowhere)
    normal, offset = faces.normal[outside.face], faces.offset[outside.face]
    return half_spaces(cuts, -normal, initial, problem, -offset)
