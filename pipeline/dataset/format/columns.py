"""What the columns of a dataset mean: said once, for its card and for the documentation."""

from dataclasses import dataclass

import pyarrow as pa

from pipeline.dataset.format.schema import SOLVED_FIELDS


@dataclass(frozen=True)
class Column:
    """A column as a reader meets it.

    Attributes:
        name: in the file.
        type: Arrow's name of its type, or the shape of a list, in row-major order.
        unit: of its numbers, or nothing.
        meaning: in words.
    """

    name: str
    type: str
    unit: str
    meaning: str


SHAPES = {"initial": "n·6", "goal": "n·6", "states": "n·T·6", "controls": "n·(T-1)·3"}
"""Shapes of the lists of doubles."""

MEANINGS = {
    "scenario_id": ("", "family, seed, n, split and index in it"),
    "n_spacecraft": ("", "n"),
    "family": ("", "`rings`, ..."),
    "split": ("", "`train`, `valid` or `test`"),
    "initial": ("m, m/s", "x y z vx vy vz of each craft at the first node"),
    "goal": ("m, m/s", "the same at the last node"),
    "status": ("", "`solved`, or why not: `infeasible` (proven), `unsolved`, `unsafe`"),
    "states": ("m, m/s", "x y z vx vy vz of each craft at each node"),
    "controls": (
        "m/s²",
        "x y z of each craft's thrust acceleration, constant over each interval",
    ),
    "fuel": ("m/s²", "Σ‖u‖₁ over craft and intervals; times Δt it is Δv in m/s"),
    "fuel_lower_bound": ("m/s²", "proven: no transfer, safe or not, needs less"),
    "optimality_gap": ("", "fuel / fuel_lower_bound - 1"),
    "node_collisions": ("", "pairs and nodes within the collision radius"),
    "min_separation": ("m", "least distance of any pair at any time"),
    "convex_solves": ("", "convex programs that the plan took"),
}
"""Unit and meaning of each column, by name."""


def _described(field: pa.Field) -> Column:
    shape = f"list of {SHAPES[field.name]} doubles" if field.name in SHAPES else str(field.type)
    return Column(field.name, shape, *MEANINGS[field.name])


COLUMNS = [_described(field) for field in SOLVED_FIELDS]
"""All columns, in their order in the file."""
