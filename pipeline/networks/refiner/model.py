"""The refiner: rounds of message passing between craft, each of which solves its own program.

Each craft begins with its decoupled optimum. In a round craft that come too close get a separating
plane, agree by message passing on who gives way by how much, and each solves

    min ‖u‖₁ + Λ Σ max(0, d - g·u)   subject to   R u = b,

where plane by plane g·u is the effect of the controls and d the effect required. The dual λ of a
plane, in [0, Λ], is the cost of another unit of separation. Without learning, the craft with the
lower cost gives way more, or gets back less; a trade is learned, by which the first craft gives way
beyond that. A craft uses only its own data and those of craft that it meets, and messages are
summed: the network is permutation-equivariant.

Arrays are numpy's in planning, which does without torch, and torch's in training. Units are r_col
and Δt. Axes: b swarms of n craft, N craft in all, T nodes, m = 3(T-1) controls, E encounters, L of
them with planes, C craft with planes, F features, H numbers of a message. A plane's first craft is
that of its encounter; relative states, (L, 2, 6), are first craft less second, at both ends of the
interval.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from safetensors.numpy import load as arrays_from

from pipeline.arrays import Array, Bool, Float, Int, like, namespace, plain
from pipeline.networks.document import Answer, EndStates, portions, read_model, read_weights
from pipeline.networks.recipes import REFINER
from pipeline.networks.refiner import geometry, programs
from pipeline.networks.refiner.arrays import cast, constant, rows, sigmoid, with_rows
from pipeline.networks.refiner.geometry import Sides
from pipeline.orbit.problem import Problem

PLANE_DISTANCE = 1.3  # in r_col, within which a local minimum of the distance gets a plane
# Distance in r_col from which an encounter is safe. Cubics are off by millimetres, by some
# centimetres in intervals of four minutes; planes ask for more, and certificates are exact.
SAFE = 1 + 1e-4
MINIMA_ONLY = 3  # rounds in which only local minima get planes, then unsafe encounters do too
MARGIN = 0.2 / 15  # separation beyond r_col that planes require, in r_col
SHARPNESS = 4.0  # a craft gives way by the other's dual to this power, as a share of both
LEAST_DUAL = 1e-4  # least dual that counts, so that duals have a ratio
MOST_TRADE = 0.3  # most that a craft gives way beyond its share, r_col
STEADY = 1e-4  # relative change of fuel in a round up to which a safe swarm has converged
FACING = np.array([1.0, -1.0])  # signs of a plane's normal for the two craft of an encounter
FEATURES = 18  # F: number of edge features of one side
FOLDER = Path(__file__).parent / "default"  # the packaged model: weights, description and card

Weights = Mapping[str, Any]
"""Weights of the network by name: ``read``, ``tell``, ``weigh`` and ``offer``, and ``hears``, 1 but
in stored models that were trained without messages, where it is 0."""


# Message passing: which craft gives way by how much.


def edge_features(
    scene: geometry.Scene,
    nodes: int,
    dual: Float[Any, "L 2"],
    first_dual: Float[Any, "L 2"],
    load: Float[Any, "L 2 3"],
    number: int | Int[Any, ""],
) -> Float[Any, "L 2 18"]:
    """Edge features of each encounter, from the side of each craft, in round ``number``.

    ``dual`` is that of the round before; ``load`` has the node features of both craft.
    """
    past, speed = geometry.passing(scene.ends, scene.share, scene.along)
    xp = namespace(dual)
    shared = [
        3 * xp.clip(1 - scene.distance, -2, 2),  # depth within r_col
        cast(scene.distance < 1, dual),  # whether it is within r_col
        (scene.interval + scene.share) / (nodes - 1),  # time, as a share of the transfer
        xp.log(speed + 0.1),  # relative speed
        xp.log(xp.linalg.vector_norm(scene.gain, axis=1) + 1e-3),  # effect of controls
        xp.zeros_like(speed) + number / 8,  # round
    ]
    own = [
        xp.log(first_dual),
        xp.clip(dual, None, 5),
        xp.log(dual + 1e-3),
        load[..., 0] / 4,  # number of planes
        xp.clip(load[..., 1], None, 10),  # sum of their duals
        xp.clip(load[..., 2], None, 5),  # fuel beyond the decoupled optimum
    ]
    both = [xp.broadcast_to(values[:, None], dual.shape) for values in shared]
    around = xp.concatenate([scene.along, past], axis=1)  # (L, 6)
    around = xp.stack([around, -around], axis=1)  # (L, 2, 6)
    return xp.concatenate([xp.stack(both + own, axis=2), around], axis=2)


def free_directions(gain: Float[Any, "L m"], grid: geometry.Grid) -> Float[Any, "L m"]:
    """Unit vectors of the controls that keep the final state and increase the distance most."""
    free = constant(gain) @ grid.free
    norm = namespace(free).linalg.vector_norm(free, axis=1, keepdims=True)
    return free / namespace(free).clip(norm, 1e-9, None)


def trades(
    weights: Weights, features: Float[Any, "L 2 F"], free: Float[Any, "L m"], sides: Sides
) -> Float[Any, "L"]:
    """Message passing: the trade of each encounter, r_col; cosines of ``free`` weigh messages."""
    xp, w = namespace(features), weights["tell.weight"]
    both = xp.concatenate([features, xp.flip(features, (1,))], axis=2)  # (L, 2, 2F)
    embedded = two_layers(weights, "read", cast(both, w))  # (L, 2, H)
    received = sides.aggregate(linear(weights, "tell", embedded), cast(free, w))  # (L, 2, 2H)
    received = weights["hears"] * received
    offered = offers(weights, embedded, received, xp.flip(received, (1,)))  # (L, 2)
    return trade_of(offered[:, 0], offered[:, 1])


def offers(
    weights: Weights,
    embedded: Float[Any, "*L H"],
    received: Float[Any, "*L _"],
    others: Float[Any, "*L _"],
) -> Float[Any, "*L"]:
    """Offers of a craft: an MLP of embedded edge features and both craft's aggregated messages."""
    every = namespace(embedded).concatenate([embedded, received, others], axis=-1)
    return linear(weights, "offer", two_layers(weights, "weigh", every))[..., 0]


def two_layers(weights: Weights, name: str, values: Float[Any, "*L k"]) -> Float[Any, "*L _"]:
    """Two linear layers with a SiLU between them."""
    hidden = linear(weights, f"{name}.0", values)
    return linear(weights, f"{name}.2", hidden * sigmoid(hidden))


def linear(weights: Weights, name: str, values: Float[Any, "*L k"]) -> Float[Any, "*L _"]:
    """A linear layer, as one product of matrices."""
    xp, weight, bias = namespace(values), weights[f"{name}.weight"], weights.get(f"{name}.bias")
    if xp is not np:
        return xp.nn.functional.linear(values, weight, bias)
    flat = values.reshape(-1, values.shape[-1]) @ weight.T
    flat = flat if bias is None else flat + bias
    return flat.reshape(*values.shape[:-1], -1)


def trade_of(offer: Float[Any, "L"], other: Float[Any, "L"]) -> Float[Any, "L"]:
    """The trade from both offers: how much the first craft gives way beyond its share, r_col."""
    return MOST_TRADE * namespace(offer).tanh(offer - other)


def separation_shares(
    distance: Float[Any, "L"],
    dual: Float[Any, "L 2"],
    first_dual: Float[Any, "L 2"],
    trade: Float[Any, "L"],
) -> Float[Any, "L 2"]:
    """How much each craft shall add to the distance of a pair, r_col.

    Of missing distance the craft with the lower dual adds more; of a surplus the one with the
    higher dual gets back more.
    """
    xp, needed = namespace(distance), 1 + MARGIN - distance
    most = xp.log(xp.clip(xp.maximum(dual, first_dual), LEAST_DUAL, None))
    now = xp.log(dual + LEAST_DUAL**1.5)
    give, get = SHARPNESS * (most[:, 1] - most[:, 0]), now[:, 0] - now[:, 1]
    first = sigmoid(xp.where(needed > 0, give, get)) * needed + cast(trade, distance)
    return xp.stack([first, needed - first], axis=1)


# The problem data, which stay the same in all rounds, and the iterate, which changes.


@dataclass(frozen=True, eq=False)
class ProblemData:
    """A batch of planning problems of n craft each, which rounds do not change."""

    grid: geometry.Grid  # maps of the problem
    n: int  # craft of each swarm
    initial: Float[Any, "N 6"]  # states
    own: programs.Decoupled  # decoupled optima
    met: geometry.Encounters  # the encounters that are considered
    swarm: Int[Any, "E"]  # index of the swarm of each of these

    def fuel(self, controls: Float[Any, "N m"]) -> Float[Any, "b"]:
        """Σ‖u‖₁ of each swarm."""
        return abs(controls).sum(axis=1).reshape(-1, self.n).sum(axis=1)


@dataclass(frozen=True, eq=False)
class Iterate:
    """The state of the iteration after a round."""

    controls: Float[Any, "N m"]  # of all craft
    states: Float[Any, "N T 6"]  # node states under these controls
    near: geometry.EncounterGeometry  # closest approaches of the encounters
    dual: Float[Any, "E 2"]  # of each plane in this round's programs, for each craft
    first_dual: Float[Any, "E 2"]  # cost of its first unit of separation; 0 before it has a plane


def problem_data(
    problem: Problem,
    initial: Float[Any, "b n 6"],
    goal: Float[Any, "b n 6"],
    radius: Float[Any, "b"],
    device: Any = None,
) -> ProblemData:
    """Planning problems from states in m and m/s, as tensors on a torch ``device`` if given."""
    grid, n = geometry.grid_of(problem), initial.shape[1]
    begin, end = (geometry.in_units(ends, radius, problem) for ends in (initial, goal))
    own = programs.decoupled_optima(begin, end, grid, problem)
    met = geometry.encounters(grid.fly(begin, own.controls), n)
    grid = geometry.grid_of(problem, device)
    return ProblemData(grid, n, like(begin, grid.drift), own, met, met.first // n)


def start(data: ProblemData) -> Iterate:
    """The first iterate: decoupled optima, without planes."""
    controls = like(data.own.controls, data.initial)
    nothing = like(np.zeros((len(data.swarm), 2)), data.swarm)
    states = data.grid.fly(data.initial, controls)
    far = nothing[:, 0] + PLANE_DISTANCE
    unseen = geometry.EncounterGeometry(far, far, far > 0)  # replaced, as all craft have moved
    moved = like(np.ones(len(states), dtype=bool), data.swarm)
    near = data.met.approaches(states, far, unseen, moved)
    return Iterate(controls, states, near, nothing, nothing)


# One round: planes, edge features, messages, the trade, the programs.


def run_round(
    weights: Weights | None,
    data: ProblemData,
    now: Iterate,
    number: int,
    active: Bool[Any, "b"] | None = None,
) -> Iterate:
    """The iterate after one round of message passing, numbered from 0; no trades without weights.

    Swarms that are not ``active`` keep their controls; by default all are.
    """
    # A plane stays, or the pair would come close again in the next round; live is (E,).
    live = gets_plane(now.near.distance, now.near.is_minimum, number) | (now.first_dual[:, 0] > 0)
    if active is not None:
        live &= active[data.swarm]
    xp = namespace(live)
    (which,) = xp.where(live)  # (L,)
    # With three nodes the goal determines all controls, and nobody can give way.
    if len(which) == 0 or data.own.others.shape[1] == 0:
        return now
    met, grid = data.met[which], data.grid
    craft = met.craft  # (L, 2)
    scene = geometry.scene_of(met.interval, now.near.share[which], met.relative(now.states), grid)
    distance, gain = scene.distance, scene.gain  # (L,), (L, m)
    first_dual = _with_first_duals(data, now.first_dual, which, like(gain, now.dual))  # (E, 2)
    dual, first, sides = now.dual[which], first_dual[which], met.sides  # (L, 2), (L, 2)
    trade = constant(distance) * 0
    if weights is not None:
        load = _node_features(sides, craft, dual, data, like(now.controls, dual))  # (L, 2, 3)
        seen = scene.like(dual)
        features = edge_features(seen, grid.nodes, dual, first, load, number)  # (L, 2, F)
        free = free_directions(gain, grid)  # (L, m)
        trade = trades(weights, like(features, gain), free, sides)  # (L,)
    share = separation_shares(distance, like(dual, gain), like(first, gain), trade)  # (L, 2)
    present = rows(now.controls, craft.reshape(-1)).reshape(len(craft), 2, -1)  # (L, 2, m)
    required = (gain[:, None] * present).sum(axis=2) * like(FACING, gain) + share  # (L, 2)
    best, duals = data.own.optima(sides, gain, required)  # (C, m), (L, 2)
    controls = with_rows(now.controls, sides.craft, best)  # (N, m)
    flown = grid.fly(rows(data.initial, sides.craft), best)  # (C, T, 6)
    states = with_rows(now.states, sides.craft, flown)  # (N, T, 6)
    dual = with_rows(xp.zeros_like(now.dual), which, duals)  # (E, 2)
    moved = xp.bincount(sides.craft, minlength=len(controls)) > 0
    # Encounters with planes are evaluated at any distance, others where they would get one.
    within = xp.full_like(dual[:, 0], PLANE_DISTANCE)
    within[first_dual[:, 0] > 0] = np.inf
    near = data.met.approaches(states, within, now.near, moved)
    return Iterate(controls, states, near, dual, first_dual)


def gets_plane(
    distance: Float[Any, "E"], is_minimum: Bool[Any, "E"], number: int | Int[Any, ""]
) -> Bool[Any, "E"]:
    """Whether encounters that have no plane yet get one in round ``number``."""
    near_minimum = is_minimum & (distance < PLANE_DISTANCE)
    return near_minimum | ((distance < SAFE) & (number >= MINIMA_ONLY))


def _with_first_duals(
    data: ProblemData, first_dual: Float[Any, "E 2"], which: Int[Any, "L"], gain: Float[Any, "L m"]
) -> Float[Any, "E 2"]:
    """First duals, with those of new planes filled in."""
    xp = namespace(first_dual)
    (new,) = xp.where(first_dual[which, 0] == 0)
    if len(new) == 0:
        return first_dual
    craft, gain = data.met[which[new]].craft, gain[new]
    found = [data.own.first_duals(craft[:, k], sign * gain) for k, sign in enumerate((1, -1))]
    return with_rows(first_dual, which[new], xp.clip(xp.stack(found, axis=1), LEAST_DUAL, None))


def _node_features(
    sides: Sides,
    craft: Int[Any, "L 2"],
    dual: Float[Any, "L 2"],
    data: ProblemData,
    controls: Float[Any, "N m"],
) -> Float[Any, "L 2 3"]:
    """Node features of both craft: number of planes, sum of duals, fuel beyond the optimum."""
    xp = namespace(dual)
    count, total = sides.totals(xp.ones_like(dual)), sides.totals(dual)
    excess = abs(controls).sum(axis=1) - abs(data.own.controls).sum(axis=1)
    return xp.stack([count, total, excess[craft]], axis=2)


# The cheapest safe iterate, which is the answer; the shortfall of separation is for training.


def cheapest_safe(
    weights: Weights | None, data: ProblemData, rounds: int
) -> tuple[Float[Any, "N m"], Bool[Any, "b"]]:
    """The cheapest safe iterate of each swarm, or the last one if none is; and whether it is safe.

    A swarm whose decoupled optima are safe keeps them; any other goes on until a round leaves it
    safe with almost the same fuel.
    """
    now = start(data)
    best, least, xp = now.controls, safe_fuel(data, now), namespace(now.controls)
    going, of_craft = xp.isinf(least), like(np.arange(len(best)) // data.n, data.swarm)
    for number in range(rounds):
        if not going.any():
            break
        before = data.fuel(now.controls)
        now = run_round(weights, data, now, number, going)
        fuel = safe_fuel(data, now)
        better = (fuel < least) | xp.isinf(least)
        best = xp.where(better[of_craft, None], now.controls, best)
        going &= ~(abs(fuel - before) <= STEADY * before)
        least = xp.minimum(least, fuel)
    return best, xp.isfinite(least)


def safe_fuel(data: ProblemData, now: Iterate) -> Float[Any, "b"]:
    """Fuel of each swarm, infinite where the iterate is not safe."""
    fuel, xp = data.fuel(now.controls), namespace(now.controls)
    unsafe = xp.bincount(data.swarm[now.near.distance < SAFE], minlength=len(fuel))
    return xp.where(unsafe > 0, np.inf, fuel)


def shortfall(data: ProblemData, now: Iterate, distance: float) -> Float[Any, "b"]:
    """Sum of the shortfalls of a distance at the local minima of each swarm's pairs, r_col.

    A closest approach that is no local minimum has a nearer one in an adjacent interval.
    """
    which = np.flatnonzero(now.near.is_minimum & (now.near.distance < distance))
    distances, _ = geometry.normals(data.met[which].relative(now.states), now.near.share[which])
    of_swarm = np.equal.outer(np.arange(len(data.initial) // data.n), data.swarm[which])
    return cast(like(of_swarm, distances), distances) @ (distance - distances)


# Trained models without torch, and the one that comes with the package.


@dataclass(frozen=True, eq=False)
class TrainedRefiner:
    """A trained refiner as arrays: a ``TrainedNetwork`` for any n, on any orbit and time grid."""

    weights: Weights | None = field(repr=False)  # by name; None for rounds without trades
    rounds: int  # that an answer takes
    problem: Problem  # of its training data, or that of ``on``
    digest: str  # SHA-256 of all that decides its answers
    device: str | None = None  # torch's for several swarms, "cpu" or "cuda"; None: compiled code

    architecture: ClassVar[str] = REFINER
    answers: ClassVar[Answer] = "controls"

    def on(self, problem: Problem) -> "TrainedRefiner":
        """The same weights for another problem."""
        return replace(self, problem=problem)

    def answer(
        self, initial: EndStates, goal: EndStates, collision_radius: float
    ) -> Float[Array, "b n _ 3"]:
        """Controls of each swarm, m/s²."""
        radius = np.full(len(initial), collision_radius)
        every = portions(initial, goal, self.problem.nodes, self.device)
        return np.concatenate([self.controls(initial[k], goal[k], radius[k]) for k in every])

    def controls(
        self, initial: Float[Any, "b n 6"], goal: Float[Any, "b n 6"], radius: Float[Any, "b"]
    ) -> Float[Array, "b n intervals 3"]:
        """Controls, m/s², of swarms that fit in memory together, each with its collision radius.

        States are in m and m/s, radii in m. With a ``device`` all is in float64, weights too, and
        several swarms are planned on it; InputError where it is not available.
        """
        weights = self.weights
        if self.device is not None and weights is not None:
            weights = {name: values.astype(np.float64) for name, values in weights.items()}
        if self.device is None or len(initial) <= 1:
            data = problem_data(self.problem, initial, goal, radius)
            controls, _ = cheapest_safe(weights, data, self.rounds)
        else:
            from pipeline.networks.refiner.tensors import planned_on

            controls = planned_on(replace(self, weights=weights), initial, goal, radius)
        unit = plain(radius) / self.problem.time_step**2
        return controls.reshape(*initial.shape[:2], -1, 3) * unit[:, None, None, None]


@lru_cache(maxsize=1)
def packaged() -> TrainedRefiner:
    """The trained refiner that comes with the package."""
    document = read_model(FOLDER)
    weights = read_weights(FOLDER, document.weights_sha256, arrays_from)
    problem = Problem(**document.problem.model_dump())
    return TrainedRefiner(weights, document.config["rounds"], problem, document.digest)
