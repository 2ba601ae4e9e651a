"""The options that say in which conditions a plan is flown."""

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pipeline.errors import InputError

if TYPE_CHECKING:
    from pipeline.flight.conditions import Conditions
    from pipeline.orbit.reference import Reference

Eccentricity = Annotated[float, typer.Option(help="Of the reference orbit, up to 0.01.")]
Inclination = Annotated[
    float | None,
    typer.Option(
        help="Of the reference orbit, deg; by default the scenario's, else 97.4.",
        show_default=False,
    ),
]
Raan = Annotated[
    float | None,
    typer.Option(
        help="Right ascension of its ascending node, deg; by default the scenario's, else 0.",
        show_default=False,
    ),
]
ArgumentOfPerigee = Annotated[float, typer.Option(help="From the ascending node, deg.")]
ArgumentOfLatitude = Annotated[
    float | None,
    typer.Option(
        help="Of the origin at the first node, deg; by default the scenario's, else 0.",
        show_default=False,
    ),
]
NoJ2 = Annotated[bool, typer.Option("--no-j2", help="Leave the Earth's oblateness out.")]
DragOn = Annotated[
    float | None,
    typer.Option(
        "--drag",
        help="Add drag: C_D A/m in the middle of the swarm, m²/kg; 0.01 is that of a CubeSat.",
        show_default=False,
    ),
]
DragSpread = Annotated[
    float | None,
    typer.Option(
        help="By what share of it the first craft has less and the last more.  [default: 0.1]",
        show_default=False,
    ),
]


def conditions_of(
    reference: "Reference | None",
    *,
    eccentricity: float,
    inclination: float | None,
    raan: float | None,
    argument_of_perigee: float,
    argument_of_latitude: float | None,
    no_j2: bool,
    drag: float | None,
    drag_spread: float | None,
) -> "Conditions":
    """What the options ask for, and where they say nothing the scenario's reference orbit.

    Raises:
        InputError: where a value makes no sense.
    """
    from pipeline.flight.conditions import Conditions

    if drag_spread is not None and drag is None:
        raise InputError(
            f"--drag-spread is {drag_spread:g} without --drag; expected both: add --drag 0.01."
        )
    given = {
        "inclination_deg": inclination,
        "raan_deg": raan,
        "argument_of_latitude_deg": argument_of_latitude,
        "spread": drag_spread,
    }
    asked = Conditions(
        eccentricity=eccentricity,
        argument_of_perigee_deg=argument_of_perigee,
        j2=not no_j2,
        ballistic=drag,
    )
    there = asked if reference is None else asked.about(reference)
    told: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    return replace(there, **told)
