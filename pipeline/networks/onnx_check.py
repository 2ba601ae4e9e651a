"""An ONNX file run by onnxruntime on one core: how near it is to torch, and how fast."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.arrays import Array
from pipeline.errors import ProlearnError
from pipeline.networks.model import Model
from pipeline.networks.onnx_files import open_session
from pipeline.orbit.transfer import fly, project_to_flyable

TOLERANCE = 1e-5
"""Largest difference from torch, as a share of a component's root mean square."""

SIZES = (1, 2, 10, 30, 100)
"""Swarm sizes that are checked and timed, as far as the file answers for them."""

INSTANCES = 4
WARM_UP = 5
REPEATS = 50


@dataclass(frozen=True)
class Checked:
    """What was measured.

    Attributes:
        n: the only number of craft that the file answers for, or None.
        most: the greatest number that it answers for, or None where there is no limit.
        difference: largest difference from torch, as a share of a component's root mean square.
        metres: largest difference of a position, m.
        seconds: median time of one instance on one core, by swarm size.
    """

    n: int | None
    most: int | None
    difference: float
    metres: float
    seconds: Mapping[int, float]

    @property
    def sizes(self) -> str:
        """The swarm sizes that the file answers for, in words."""
        if self.n is not None:
            return f"n = {self.n}"
        return "any n" if self.most is None else f"n = 1 to {self.most}"


def check(path: Path, model: Model, n: int | None, *, flown: bool) -> Checked:
    """Run a file on random swarms, and find out how large they may be.

    Args:
        path: the ONNX file.
        model: what it was made from.
        n: the only number of craft that it is meant for, or None.
        flown: whether it answers with transfers that can be flown, and their controls.

    Raises:
        InputError: where onnxruntime is not installed.
        ProlearnError: where its answer differs from torch's by more than TOLERANCE.
    """
    session = open_session(path)
    differences: dict[int, tuple[float, float]] = {}
    for sizes, most in _claims(model, n):
        for size in sizes:
            differences[size] = _difference(session, model, size, flown=flown)
        shares, metres = zip(*(differences[size] for size in sizes), strict=True)
        if max(shares) <= TOLERANCE:
            seconds = {size: _seconds(session, model, size) for size in sizes}
            return Checked(n, most, max(shares), max(metres), seconds)
    raise ProlearnError(
        f"onnxruntime's answer differs from torch's by {max(shares):.2g} of a component's root "
        f"mean square; expected at most {TOLERANCE:g}: the file was not written."
    )


def _claims(model: Model, n: int | None) -> list[tuple[list[int], int | None]]:
    """Swarm sizes to check, the widest claim first, and the greatest size then claimed."""
    if n is not None:
        return [([n], n)]
    sizes = sorted({*SIZES, model.n_train})
    return [(sizes, None), ([s for s in sizes if s <= model.n_train], model.n_train)]


def _ends(model: Model, n: int, instances: int) -> dict[str, Float[Array, "N n 6"]]:
    """Random end states of the size of the training data's, in float32."""
    rng = np.random.default_rng(n)
    scale = np.array(model.encoding.input_scale)
    drawn = rng.normal(size=(2, instances, n, 6)) * scale
    return {"initial": drawn[0].astype(np.float32), "goal": drawn[1].astype(np.float32)}


def _difference(session: Any, model: Model, n: int, *, flown: bool) -> tuple[float, float]:
    """Largest difference as a share of a component's root mean square, and of positions in m."""
    ends = _ends(model, n, INSTANCES)
    try:
        given: Sequence[Array] = session.run(None, ends)
    except Exception:  # onnxruntime's own kinds, all directly under Exception
        return math.inf, math.inf
    wanted = _wanted(model, *(e.astype(np.float64) for e in ends.values()), flown=flown)
    if [g.shape for g in given] != [w.shape for w in wanted]:
        return math.inf, math.inf
    shares = [
        np.abs(g - w).max(axis=(0, 1, 2)) / np.sqrt(np.square(w).mean(axis=(0, 1, 2)))
        for g, w in zip(given, wanted, strict=True)
    ]
    metres = np.abs(given[0] - wanted[0])[..., :3].max()
    return float(np.concatenate(shares).max()), float(metres)


def _wanted(
    model: Model, initial: Float[Array, "N n 6"], goal: Float[Array, "N n 6"], *, flown: bool
) -> list[Array]:
    """Torch's answer."""
    predicted = model.predict(initial, goal)
    if not flown:
        return [predicted]
    controls = project_to_flyable(predicted, initial, goal, model.problem)
    return [fly(initial, controls, model.problem), controls]


def _seconds(session: Any, model: Model, n: int) -> float:
    """Median time of one instance, after a few to warm up."""
    ends = _ends(model, n, 1)
    times = []
    for _ in range(WARM_UP + REPEATS):
        started = time.perf_counter()
        session.run(None, ends)
        times.append(time.perf_counter() - started)
    return float(np.median(times[WARM_UP:]))
