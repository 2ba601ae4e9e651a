"""What the sides of encounters see, compiled, and by what the planes of a craft are alike."""

from dataclasses import dataclass
from math import log
from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Float, Float32
from numba import njit
from torch import Tensor

from pipeline.networks.refiner.compiled import numbers
from pipeline.networks.refiner.encounters import Encounters
from pipeline.networks.refiner.grid import Grid
from pipeline.networks.refiner.planes import Planes
from pipeline.networks.refiner.program import Own

FEATURES = 18
"""Numbers that a side sees."""


@dataclass(frozen=True, eq=False)
class Meeting:
    """Some encounters as they are in a round.

    Attributes:
        met: pairs and intervals.
        share: when they are closest, as a share of the interval, (L,).
        planes: between them.
        price: what the plane cost either craft in the round before, (L, 2).
        first_price: what the first unit costs either craft, (L, 2).
    """

    met: Encounters
    share: Float[Tensor, "L"]
    planes: Planes
    price: Float[Tensor, "L 2"]
    first_price: Float[Tensor, "L 2"]


def seen(
    meeting: Meeting, own: Own, controls: Float[Tensor, "N m"], grid: Grid, number: int
) -> Float32[Tensor, "L 2 F"]:
    """What each side sees in the round of a number: its craft, the encounter, directions there."""
    met, planes = meeting.met, meeting.planes
    result = torch.empty(len(meeting.share), 2, FEATURES, dtype=torch.float32)
    time = (met.interval + meeting.share) / (grid.nodes - 1)
    there = (planes.distance, planes.gain, planes.along, planes.motion, planes.speed)
    given = (met.craft, time, *there, meeting.price, meeting.first_price, controls, own.controls)
    _see(*map(numbers, given), number / 8, result.numpy())
    return result.to(controls.device)


@no_type_check
@njit(cache=True)
def _see(
    craft,
    time,
    distance,
    gain,
    along,
    motion,
    speed,
    price,
    first_price,
    controls,
    own,
    number,
    result,
):
    """What sides see; ``on_board.seen`` has it as formulas.

    Args:
        craft: both craft of each encounter, (L, 2).
        time: of the encounter as a share of the transfer, (L,).
        distance: to the other craft, (L,).
        gain: how the first craft's controls move it away, (L, m).
        along: unit vector from the second craft to the first, (L, 3).
        motion: along their motion past each other, (L, 3).
        speed: of it, (L,).
        price: of the plane in the round before, (L, 2).
        first_price: of its first unit, (L, 2).
        controls: of all craft, (N, m).
        own: own optima, (N, m).
        number: that stands for the round.
        result: (L, 2, F), float32.
    """
    sides, paid = np.zeros(len(own)), np.zeros(len(own))
    for k in range(len(craft)):
        for side in range(2):
            sides[craft[k, side]] += 1
            paid[craft[k, side]] += price[k, side]
    spent = np.zeros(len(own))
    for c in range(len(own)):
        if sides[c] > 0:
            for x in range(own.shape[1]):
                spent[c] += abs(controls[c, x]) - abs(own[c, x])
    for k in range(len(craft)):
        strength = 0.0
        for x in range(gain.shape[1]):
            strength += gain[k, x] * gain[k, x]
        for side in range(2):
            mine, sees, sign = craft[k, side], result[k, side], -1.0 if side else 1.0
            sees[0] = 3 * min(max(1 - distance[k], -2.0), 2.0)
            sees[1] = 1.0 if distance[k] < 1 else 0.0
            sees[2] = time[k]
            sees[3] = log(speed[k] + 0.1)
            sees[4] = log(np.sqrt(strength) + 1e-3)
            sees[5] = number
            sees[6] = log(first_price[k, side])
            sees[7] = min(price[k, side], 5.0)
            sees[8] = log(price[k, side] + 1e-3)
            sees[9] = sides[mine] / 4
            sees[10] = min(paid[mine], 10.0)
            sees[11] = min(spent[mine], 5.0)
            for x in range(3):
                sees[12 + x], sees[15 + x] = sign * along[k, x], sign * motion[k, x]


def free_directions(gain: Float[Tensor, "L m"], grid: Grid) -> Float32[Tensor, "L m"]:
    """How controls that keep the goal move each plane most, as unit vectors."""
    free = gain.detach() @ grid.free
    return (free / torch.linalg.vector_norm(free, dim=1, keepdim=True).clamp(min=1e-9)).float()
