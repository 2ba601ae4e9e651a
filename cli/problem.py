"""The options that say what problem is asked: orbit, time grid, collision radius, thrust limit."""

from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.errors import InputError

if TYPE_CHECKING:
    from pipeline.orbit.problem import Problem

Altitude = Annotated[float, typer.Option(help="Of the reference orbit, m.")]
TimeStep = Annotated[float, typer.Option(help="Length of an interval, s.")]
Nodes = Annotated[int, typer.Option(help="Time nodes.")]
CollisionRadius = Annotated[float, typer.Option(help="r_col, m.")]
MaxAcceleration = Annotated[float | None, typer.Option(help="Limit on each component, m/s².")]


def problem_at(
    altitude: float,
    time_step: float,
    nodes: int,
    collision_radius: float,
    max_acceleration: float | None,
) -> "Problem":
    """The problem on a circular orbit so high above the Earth.

    Raises:
        InputError: where a value makes no sense.
    """
    from pipeline.orbit.problem import Problem
    from pipeline.orbit.reference import mean_motion_at

    if not altitude > 0:
        raise InputError(f"--altitude is {altitude}; expected a positive number of metres.")
    return Problem(mean_motion_at(altitude), time_step, nodes, collision_radius, max_acceleration)
