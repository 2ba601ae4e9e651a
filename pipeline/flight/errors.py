"""Errors of navigation and thrust in flight, and their draws trial by trial."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import prod

import numpy as np

from pipeline.arrays import Array, Float, Int
from pipeline.errors import check_whole
from pipeline.orbit.arrays import norm
from pipeline.orbit.covariance import MAX_ERRORS, Uncertainty, is_burn, navigation_roots
from pipeline.orbit.problem import Problem
from pipeline.scenario.families import SEEDS


@dataclass(frozen=True)
class Errors(Uncertainty):
    """Standard deviations of Gaussian errors, and probabilities of missed burns and lost thrust.

    Those of ``Uncertainty`` are drawn anew at each node (position, velocity) and for each burn
    (magnitude, direction). Position and velocity are errors of the navigation of a craft, in each
    component; a relative position is known √2 times worse. Burns have the four errors of Gates
    (1963), two proportional to the burn and two fixed. docs/flight-errors.md has all of them.

    Attributes:
        timing: by how much a burn begins and ends late, or early, s.
        missed: probability that a burn is not made at all.
        lost: probability that in a trial a random craft loses its thrust for good, at a random
            time.
        impulse_bit: each component's Δv over an interval is rounded to a multiple of this, m/s.
    """

    timing: float = 0.0
    missed: float = 0.0
    lost: float = 0.0
    impulse_bit: float = 0.0

    def gaussian(self, time_step: float) -> Uncertainty:
        """The equivalent Gaussian errors for a time step, s, without missed burns and lost thrust.

        A burn that is late by τ falls short in position like one that is too small by 2τ/h; one
        that is rounded to multiples of a bit errs by the bit over √12.
        """
        late, rounded = 2 * self.timing / time_step, self.impulse_bit / 12**0.5
        return replace(
            super().gaussian(time_step),
            magnitude=min(float(np.hypot(self.magnitude, late)), MAX_ERRORS["magnitude"]),
            direction_fixed=float(np.hypot(self.direction_fixed, rounded)),
        )


_NAVIGATION = {"position": 0.05, "velocity": 5e-4, "position_bias": 0.02, "velocity_bias": 1e-4}

COLD_GAS = Errors(
    **_NAVIGATION,
    magnitude=0.02,
    direction=0.02,
    magnitude_fixed=1e-4,
    direction_fixed=1e-4,
    timing=0.1,
    missed=1e-3,
)
"""A swarm of nanosatellites with cold gas and carrier-phase differential GPS.

- position: 5 cm, so 7 cm on each axis between two craft. CanX-4 and 5 were to know their relative
  position to 10 cm and did (G. Bonin et al., "CanX-4 and CanX-5 precision formation flight:
  mission accomplished!", SmallSat 2015); simulations for PRISMA have 0.1 m in real time (E. Gill,
  S. D'Amico, O. Montenbruck, "Autonomous formation flying for the PRISMA mission", J. Spacecraft
  and Rockets 44(3), 2007).
- velocity: 0.5 mm/s, of hardware in the loop for Orion (P. Ferguson, F. Busse, J. How, "Navigation
  performance predictions for the Orion formation flying mission", 2003).
- kinds of thrust error: C. R. Gates, "A simplified model of midcourse maneuver execution errors",
  JPL TR 32-504, 1963.
- everything else is our own choice, of the size that such hardware suggests: 2 % of a burn's size;
  0.02 rad (1.1°) of attitude and alignment; 0.1 mm/s fixed, which is 20 ms of a valve at 35 mN and
  7 kg; 0.1 s of timing; biases of 2 cm and 0.1 mm/s; one burn in a thousand missed.
"""

_FILTERED = {"semi_major_axis": 0.1, "navigation_time": 300.0}

CALIBRATED = replace(COLD_GAS, **_FILTERED, magnitude=0.01, direction=0.01, magnitude_bias=0.005)
"""The same swarm with thrusters that are calibrated in flight, and errors of a navigation filter.

Our own choice: the errors of a filter are correlated over some 5 minutes, and it knows the
relative semi-major axis, which decides how craft drift, to 0.1 m; errors of position and velocity
that were independent would put it at 1 m, which no filter does.
"""

UNCALIBRATED = replace(
    COLD_GAS, **_FILTERED, magnitude_bias=0.05, direction_bias=0.02, impulse_bit=1e-4
)
"""The same swarm as launched: the errors of each craft's thrusters are the same in all burns.

Our own choice: 5 % of their size and 1.1° of alignment; Δv comes in bits of 0.1 mm/s.
"""

ELECTRIC = Errors(
    **_NAVIGATION,
    **_FILTERED,
    magnitude=0.005,
    direction=0.01,
    magnitude_bias=0.01,
    direction_bias=0.01,
)
"""A swarm with electric thrusters, steady and slow to change: our own choice.

No burn is missed or late, and none has an error that does not grow with it.
"""

PRESETS: Mapping[str, Errors] = {
    "none": Errors(),
    "cold-gas": COLD_GAS,
    "calibrated": CALIBRATED,
    "uncalibrated": UNCALIBRATED,
    "electric": ELECTRIC,
}  # by name


@dataclass(frozen=True, eq=False)
class Draws:
    """Random numbers of K trials of n craft: standard normal; ``missed``, ``loss`` are uniform.

    The same trial has the same draws whatever the errors, and however it is flown.
    """

    bias: Float[Array, "K n 6"]  # for the bias of each estimate
    noise: Float[Array, "K intervals n 6"]  # for its noise at the node that begins each interval
    burn: Float[Array, "K intervals n 3"]  # for the error of each interval's burn
    lag: Float[Array, "K intervals n"]  # for the delay of each burn
    missed: Float[Array, "K intervals n"]  # decides whether a burn is missed
    thruster: Float[Array, "K n 4"]  # for biases of a craft's thrusters: magnitude and rotation
    loss: Float[Array, "K 3"]  # decides whether a craft loses its thrust, which one, and when


def check_seed(seed: int) -> None:
    """Refuse a root seed out of range with an InputError."""
    check_whole("seed", seed, 0, SEEDS - 1)


def draws(seed: int, trials: range, n: int, intervals: int) -> Draws:
    """The draws of some trials, each a function of (seed, trial, n, intervals) alone.

    In the stream of a counter-based generator (J. Salmon et al., "Parallel random numbers: as easy
    as 1, 2, 3", SC 2011) the numbers of trial k have a fixed place, so that any range of trials is
    drawn at once; normal numbers are by inversion.
    """
    shapes = (n, 6), (intervals, n, 6), (intervals, n, 3), (intervals, n), (intervals, n)
    seed = int(seed)  # numpy's integers may be too short for what is added
    bias, noise, burn, lag, missed = _uniform(seed, trials, *shapes)
    (thruster,) = _uniform(seed + SEEDS, trials, (n, 4))
    (loss,) = _uniform(seed + 2 * SEEDS, trials, (3,))
    from scipy.special import ndtri  # slow to import, and only trials need it

    # 0, whose normal number is infinite, is replaced by a number close to it.
    normal = (ndtri(np.maximum(u, 2.0**-54)) for u in (bias, noise, burn, lag, thruster))
    bias, noise, burn, lag, thruster = normal
    return Draws(bias, noise, burn, lag, missed, thruster, loss)


def _uniform(key: int, trials: range, *shapes: tuple[int, ...]) -> list[Float[Array, "K ..."]]:
    """Uniform numbers of some shapes for each trial, from the stream of a key."""
    count, sizes = len(trials), [prod(shape) for shape in shapes]
    blocks = -(-sum(sizes) // 4)  # of four numbers, by which the counter counts
    stream = np.random.Philox(key=key, counter=trials.start * blocks)
    numbers = np.random.Generator(stream).random((count, 4 * blocks))[:, : sum(sizes)]
    parts = np.split(numbers, np.cumsum(sizes)[:-1], axis=1)
    return [part.reshape(count, *shape) for part, shape in zip(parts, shapes, strict=True)]


@dataclass(frozen=True, eq=False)
class Loss:
    """The craft of each trial that loses its thrust for good, if one does."""

    craft: Int[Array, "K"]  # -1 where none does
    time: Float[Array, "K"]  # of the loss, s since the first node; NaN where there is none
    node: Float[Array, "K"]  # the first at which it is adrift; infinite where none is
    latency: int  # number of nodes after which the others know

    def by(self, node: int) -> Int[Array, "K"]:
        """The craft of each trial that is adrift at a node; -1 where none is."""
        return np.where(self.node <= node, self.craft, -1)


def lost_thrust(drawn: Draws, errors: Errors, problem: Problem) -> Loss:
    """Losses of thrust, of a uniformly random craft at a uniformly random time."""
    whether, which, when = drawn.loss.T
    lost, n = whether < errors.lost, drawn.bias.shape[1]
    craft = np.where(lost, (which * n).astype(int), -1)
    node = np.where(lost, np.ceil(when * problem.intervals), np.inf)
    return Loss(craft, np.where(lost, when * problem.duration, np.nan), node, int(errors.latency))


def navigation_errors(
    drawn: Draws, errors: Errors, problem: Problem
) -> Float[Array, "K intervals n 6"]:
    """Estimated states at nodes minus true ones, m and m/s: bias, and correlated noise."""
    noise, bias = navigation_roots(errors, problem)
    mixed, nodes = drawn.noise, np.arange(problem.intervals)
    if errors.navigation_time > 0:
        lag = np.abs(nodes[:, None] - nodes) * problem.time_step
        root = np.linalg.cholesky(np.exp(-lag / errors.navigation_time))
        mixed = np.einsum("kl,Klnj->Kknj", root, mixed)
    return np.matvec(bias, drawn.bias)[:, None] + np.matvec(noise, mixed)


@dataclass(frozen=True, eq=False)
class ExecutedBurns:
    """Burns over an interval, with thrust errors."""

    held: Float[Array, "K n 3"]  # controls held over it, m/s²
    late: Float[Array, "K n 3"]  # uτ of a delay τ: Δv missing at its start, added at its end, m/s
    missed: Int[Array, "K"]  # number of burns that each trial misses


def burns_made(
    commanded: Float[Array, "K n 3"], drawn: Draws, interval: int, errors: Errors, time_step: float
) -> ExecutedBurns:
    """The burns made where controls, m/s², are commanded over an interval of ``time_step`` s.

    A burn that is late by τ is modelled as the burn in time with an impulse of -uτ at its start
    and one of uτ at its end: the position after it is off by uτ²/2, the velocity by the mean motion
    times as much. A missed burn has no impulses. Burns are rounded to whole impulse bits.
    """
    if errors.impulse_bit > 0:
        bit = errors.impulse_bit / time_step
        commanded = bit * np.round(commanded / bit)
    size, burning = norm(commanded), is_burn(commanded, time_step)
    missed = burning & (drawn.missed[:, interval] < errors.missed)
    unit = commanded / np.where(burning, size, 1.0)[..., None]
    draw = drawn.burn[:, interval]
    along = np.vecdot(draw, unit)[..., None] * unit
    in_size = np.hypot(errors.magnitude * size, errors.magnitude_fixed / time_step)
    across = np.hypot(errors.direction * size, errors.direction_fixed / time_step)
    error = in_size[..., None] * along + across[..., None] * (draw - along)
    if errors.magnitude_bias or errors.direction_bias:
        error += errors.magnitude_bias * drawn.thruster[..., :1] * commanded
        error += errors.direction_bias * np.cross(drawn.thruster[..., 1:], commanded)
    burns, lag = burning[..., None], errors.timing * drawn.lag[:, interval]
    held = np.where(missed[..., None], 0.0, np.where(burns, commanded + error, commanded))
    return ExecutedBurns(held, np.where(burns, held * lag[..., None], 0.0), missed.sum(axis=1))
