"""A whole swarm, craft by craft: each runs the steps by itself, and knows only what it was told."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.networks.refiner.on_board.steps import ROUND
from pipeline.networks.refiner.on_board.values import TOLD

Known = dict[str, Any]
"""What one craft knows: arrays by the names of ``values``."""

Run = Callable[[str, Known], Mapping[str, Any]]
"""Runs the step of a name on what one craft knows, and gives its outputs by name."""


@dataclass(frozen=True)
class Side:
    """One craft's side of an encounter.

    Attributes:
        craft: whose side.
        place: among its encounters.
        other: the craft that it meets.
        there: the encounter's place among those of the other craft.
    """

    craft: int
    place: int
    other: int
    there: int


def fly_rounds(
    run: Run,
    initial: Float[Array, "n 6"],
    goal: Float[Array, "n 6"],
    r_col: float,
    *,
    rounds: int,
) -> Iterator[Float[Array, "n m"]]:
    """Controls of all craft, m/s²: the own optima, and after each round.

    Args:
        run: how a craft runs a step.
        initial: m and m/s.
        goal: m and m/s.
        r_col: collision radius, m.
        rounds: how many.
    """
    swarm: list[Known] = [
        {"initial": start, "goal": end, "r_col": np.array(r_col)}
        for start, end in zip(initial, goal, strict=True)
    ]
    for craft in swarm:
        craft.update(run("begin", craft))
    sides = _met(run, swarm)
    _tell(swarm, sides, ("nodes", "price"))
    yield np.stack([craft["controls"] for craft in swarm])
    for number in range(rounds):
        for name, step in ROUND.items():
            for k in {side.craft for side in sides}:  # others keep their own optimum
                swarm[k].update(run(name, {**swarm[k], "number": np.array(number)}))
            about = (
                sides if step.tells_all else [s for s in sides if swarm[s.craft]["live"][s.place]]
            )
            _tell(swarm, about, step.tells)
        yield np.stack([craft["controls"] for craft in swarm])


def _met(run: Run, swarm: Sequence[Known]) -> list[Side]:
    """The sides of all encounters; every craft writes down its own."""
    others = [[j for j in range(len(swarm)) if j != k] for k in range(len(swarm))]
    places: dict[tuple[int, int, int], int] = {}
    for k, craft in enumerate(swarm if len(swarm) > 1 else ()):
        told = np.stack([swarm[j]["states"] for j in others[k]])
        which, interval = np.nonzero(run("meet", {**craft, TOLD + "states": told})["met"])
        for place, (q, t) in enumerate(zip(which, interval, strict=True)):
            places[k, others[k][q], int(t)] = place
        states, count = craft["states"], len(interval)
        craft["interval"] = interval
        craft["nodes"] = np.stack([states[interval], states[interval + 1]], axis=1)
        craft["price"], craft["first_price"] = np.zeros((2, count))
    return [Side(k, place, j, places[j, k, t]) for (k, j, t), place in places.items()]


def _tell(swarm: Sequence[Known], sides: Sequence[Side], names: Sequence[str]) -> None:
    """On each of some sides, a craft is told what has these names by the one that it meets."""
    for name in names:
        for side in sides:
            craft = swarm[side.craft]
            told = craft.setdefault(TOLD + name, np.zeros_like(craft[name]))
            told[side.place] = swarm[side.other][name][side.there]
        for craft in swarm:  # who is told nothing knows nothing, but in the right shape
            if name in craft:
                craft.setdefault(TOLD + name, np.zeros_like(craft[name]))
