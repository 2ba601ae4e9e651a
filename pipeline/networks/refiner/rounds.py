"""The rounds: see who meets, agree on planes, let each craft solve its program; again.

A plane stands between the two craft of an encounter at its closest approach, and moves: where it
must move by δ to keep them r_col apart, the first craft gives way by w δ and the second by the
rest. Without learning, w follows the prices, so that the craft to which it is cheaper gives way,
or gets back less. What is learned is a trade: what the first gives way beyond its share.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from pipeline.networks.least_fuel import least_fuel
from pipeline.networks.refiner.bargain import Bargain
from pipeline.networks.refiner.encounters import Encounters, Look, candidates, look, look_again
from pipeline.networks.refiner.grid import Grid, grid_of, in_units
from pipeline.networks.refiner.planes import Planes, planes
from pipeline.networks.refiner.program import LEAST_FUEL, Own, Program, own_tableau
from pipeline.networks.refiner.seen import Meeting, free_directions, seen
from pipeline.networks.refiner.sides import sides_of
from pipeline.networks.swarms import Swarms

NEAR = 4.0
"""Distance in r_col up to which own optima must come for a pair to be looked at at all."""

NEAR_OF_EXTENT = 0.15
"""The same as a part of the swarm's extent: who flies far can be sent far off at little cost."""

WATCHED = 1.3
"""Distance in r_col within which a pair that turns from coming closer to parting gets a plane."""

SAFE = 1 + 1e-4
"""Distance in r_col from which an encounter is called safe. Cubics are off by millimetres, by some
centimetres in intervals of four minutes; planes ask for more, and certificates are exact."""

TURNS_ONLY = 3
"""Rounds in which pairs get planes only where they turn; after them also wherever unsafe."""

MARGIN = 0.2 / 15
"""Separation beyond r_col that is asked for, in r_col."""

SHARPNESS = 4.0
"""Power of the other's price by which a craft gives way."""

LEAST_PRICE = 1e-4
"""Price that stands for none, so that there is a ratio of prices."""


@dataclass(frozen=True, eq=False)
class Task:
    """What stays the same over the rounds, N craft of swarms of n, in units of r_col and Δt.

    Attributes:
        grid: the problem.
        n: craft of each swarm.
        initial: states, (N, 6).
        own: own optima.
        met: pairs and intervals that are looked at.
        swarm: whose each of these is.
    """

    grid: Grid
    n: int
    initial: Float[Tensor, "N 6"]
    own: Own
    met: Encounters
    swarm: Int[Tensor, "E"]

    def total(self, values: Float[Tensor, "k"], swarm: Int[Tensor, "k"]) -> Float[Tensor, "b"]:
        """Sums over each swarm of what belongs to it."""
        return values.new_zeros(len(self.initial) // self.n).index_add(0, swarm, values)

    def fuel(self, controls: Float[Tensor, "N m"]) -> Float[Tensor, "b"]:
        """Σ‖u‖₁ of each swarm."""
        return controls.abs().sum(dim=1).reshape(-1, self.n).sum(dim=1)


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of each encounter, E in all.

    Attributes:
        first_price: what the first unit costs either craft, (E, 2); 0 where it was not asked yet.
        price: of the plane in the round before, (E, 2).
    """

    first_price: Float[Tensor, "E 2"]
    price: Float[Tensor, "E 2"]


@dataclass(frozen=True, eq=False)
class State:
    """Where the rounds stand.

    Attributes:
        controls: of all craft, (N, m).
        states: that they fly, (N, T, 6).
        found: how close the craft of every encounter come.
        known: what is known of every encounter.
    """

    controls: Float[Tensor, "N m"]
    states: Float[Tensor, "N T 6"]
    found: Look
    known: Known

    def planes(self, task: Task, which: Int[Tensor, "L"]) -> tuple[Encounters, Planes]:
        """Some encounters, and the planes between their craft."""
        met = task.met.of(which)
        return met, planes(met, self.found.share[which], self.states, task.grid)

    def lack(self, task: Task, distance: float) -> Float[Tensor, "b"]:
        """What encounters of each swarm lack of a distance where pairs turn to part, r_col.

        Elsewhere a pair that lacks something lacks more in the interval before or after.
        """
        which = (self.found.turns & (self.found.distance < distance)).nonzero()[:, 0]
        _, between = self.planes(task, which)
        return task.total(distance - between.distance, task.swarm[which])


def begin(swarms: Swarms) -> Task:
    """Own optima, and who may meet."""
    problem, radius = swarms.problem, swarms.collision_radius
    grid, n = grid_of(problem, radius.device), swarms.initial.shape[1]
    initial, goal = (in_units(x, radius, problem) for x in (swarms.initial, swarms.goal))
    miss = goal - initial @ grid.drift[-6:].T
    found = least_fuel(torch.cat([miss[:, :3], miss[:, 3:] / problem.time_step], dim=1), problem)
    m = grid.reach.shape[1]
    controls = found.controls.reshape(-1, m) * problem.time_step**2
    side = torch.where(found.basis < m, 1.0, -1.0).to(controls.dtype)
    own = own_tableau(controls, found.basis % m, side, grid.to_goal)
    met = candidates(grid.fly(initial, controls), n, NEAR, NEAR_OF_EXTENT)
    return Task(grid, n, initial, own, met, met.first // n)


def start(task: Task) -> State:
    """The own optima, before anybody has met."""
    controls = task.own.controls
    nothing = controls.new_zeros(len(task.met.first), 2)
    states, known = task.grid.fly(task.initial, controls), Known(nothing, nothing)
    return State(controls, states, look(task.met, states, _worth_a_look(known)), known)


def play(
    network: Bargain | None,
    task: Task,
    state: State,
    number: int,
    among: Bool[Tensor, "b"] | None = None,
    program: Program = LEAST_FUEL,
) -> State:
    """One round; by the rule alone without a network.

    Args:
        network: what was learned.
        task: what stays the same.
        state: where the rounds stand.
        number: of the round, from 0.
        among: swarms that go on; the others keep their controls. All of them by default.
        program: what each craft solves.
    """
    # A plane once put up stays, or pairs would forget each other and meet again.
    live = meets(state.found.distance, state.found.turns, number)
    live |= state.known.first_price[:, 0] > 0
    if among is not None:
        live &= among[task.swarm]
    which = live.nonzero()[:, 0]
    # With three nodes the goal determines all controls, and nobody can give way.
    if len(which) == 0 or task.own.others.shape[1] == 0:
        return state
    met, between = state.planes(task, which)
    gain = between.gain
    known = _with_first_prices(task, state.known, which, gain.detach(), program)
    meeting = Meeting(
        met, state.found.share[which], between, known.price[which], known.first_price[which]
    )
    sides, trade = sides_of(met.craft, len(state.controls)), None
    if network is not None:
        sight = seen(meeting, task.own, state.controls, task.grid, number)
        trade = network(sight, sides, free_directions(gain, task.grid))
    first, second = ((gain * state.controls.index_select(0, k)).sum(dim=1) for k in met.both)
    asked = torch.stack([first, -second], dim=1) + to_give(meeting, trade)
    best, paid = program.optimum(task.own, sides, gain, asked, task.grid)
    controls = state.controls.index_copy(0, sides.craft, best)
    flown = task.grid.fly(task.initial[sides.craft], best)
    states = state.states.index_copy(0, sides.craft, flown)
    price = torch.zeros_like(known.price).index_copy(0, which, paid)
    known = replace(known, price=price)
    moved = torch.zeros_like(controls[:, 0], dtype=torch.bool).index_fill(0, sides.craft, True)
    found = look_again(state.found, task.met, states, _worth_a_look(known), moved)
    return State(controls, states, found, known)


def meets(
    distance: Float[Tensor, "k"], turns: Bool[Tensor, "k"], number: int | Int[Tensor, ""]
) -> Bool[Tensor, "k"]:
    """Whether pairs that have no plane yet get one in the round of a number."""
    return (turns & (distance < WATCHED)) | ((distance < SAFE) & (number >= TURNS_ONLY))


def _worth_a_look(known: Known) -> Float[Tensor, "E"]:
    """Distance within which encounters are seen: anywhere, or where they would get a plane."""
    return torch.where(known.first_price[:, 0] > 0, torch.inf, WATCHED)


def to_give(meeting: Meeting, trade: Float[Tensor, "L"] | None) -> Float[Tensor, "L 2"]:
    """By how much either craft is to give way, r_col."""
    needed = 1 + MARGIN - meeting.planes.distance
    first = torch.sigmoid(_usual_share(needed, meeting.price, meeting.first_price)) * needed
    if trade is not None:
        first = first + trade.to(first.dtype)
    return torch.stack([first, needed - first], dim=1)


def _usual_share(
    needed: Float[Tensor, "L"], price: Float[Tensor, "L 2"], first_price: Float[Tensor, "L 2"]
) -> Float[Tensor, "L"]:
    """The logit of the first craft's share by the rule.

    Of way to be given, the craft with the lower price gives more; of way to be got back, the one
    with the higher price gets more.
    """
    most = torch.maximum(price, first_price).clamp(min=LEAST_PRICE).log()
    now = (price + LEAST_PRICE**1.5).log()
    give, get = SHARPNESS * (most[:, 1] - most[:, 0]), now[:, 0] - now[:, 1]
    return torch.where(needed > 0, give, get)


def _with_first_prices(
    task: Task,
    known: Known,
    which: Int[Tensor, "L"],
    gain: Float[Tensor, "L m"],
    program: Program,
) -> Known:
    """First prices of encounters that are live for the first time."""
    new = (known.first_price[which, 0] == 0).nonzero()[:, 0]
    if len(new) == 0:
        return known
    met, gain = task.met.of(which[new]), gain[new]
    prices = [
        program.price(task.own, craft, sign * gain, task.grid)
        for craft, sign in zip(met.both, (1, -1), strict=True)
    ]
    both = torch.stack(prices, dim=1).clamp(min=LEAST_PRICE)
    return replace(known, first_price=known.first_price.index_copy(0, which[new], both))
