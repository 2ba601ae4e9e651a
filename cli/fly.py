"""The command that flies a plan outside the linear model."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from cli.app import FAILED
from cli.conditions import (
    ArgumentOfLatitude,
    ArgumentOfPerigee,
    DragOn,
    DragSpread,
    Eccentricity,
    Inclination,
    NoJ2,
    Raan,
    conditions_of,
)
from cli.output import AsJson, print_json, print_table
from pipeline.errors import InputError
from pipeline.exhibits.numbers import MISSING, error, number


def fly(
    plan: Annotated[Path, typer.Argument(help="Plan file.", show_default=False)],
    eccentricity: Eccentricity = 0.001,
    inclination: Inclination = None,
    raan: Raan = None,
    argument_of_perigee: ArgumentOfPerigee = 90.0,
    argument_of_latitude: ArgumentOfLatitude = None,
    no_j2: NoJ2 = False,
    drag: DragOn = None,
    drag_spread: DragSpread = None,
    as_json: AsJson = False,
) -> None:
    """Fly a plan's controls about an oblate Earth, and say how far off they lead.

    Every craft is integrated on its own in an inertial frame, from a reference orbit that need
    not be a circle, under two-body gravity, J2 and, if asked for, drag. The table has a row for
    each effect, added to those above it: how far the worst craft then ends from its goal, what
    the effect added at most, its share of the final error, and which pair comes closest when.
    Exit status 0: no pair comes within r_col at any time; 1: one does; 2: bad input.

    Examples:

        prolearn fly plan.json
        prolearn fly plan.json --eccentricity 0.005 --inclination 51.6
        prolearn fly plan.json --drag 0.01 --drag-spread 0.2
        prolearn fly plan.json --eccentricity 0 --no-j2 --json
    """
    from pipeline.flight.effects import effects
    from pipeline.flight.report import flight_report
    from pipeline.plan.document import read_whole_plan

    made, scenario = read_whole_plan(plan)
    conditions = conditions_of(
        scenario.reference,
        eccentricity=eccentricity,
        inclination=inclination,
        raan=raan,
        argument_of_perigee=argument_of_perigee,
        argument_of_latitude=argument_of_latitude,
        no_j2=no_j2,
        drag=drag,
        drag_spread=drag_spread,
    )
    try:
        found = effects(scenario, made.controls, conditions)
    except InputError as wrong:
        raise InputError(f"{plan}: {wrong}") from wrong
    report = {"plan": str(plan), **flight_report(made, scenario, conditions, found)}
    print_json(report) if as_json else print_flight(report)
    raise typer.Exit(0 if report["safe"] else FAILED)


HEADINGS = (
    "flown with",
    "off goal\nm",
    "\nmm/s",
    "added\nm",
    "share",
    "closest\npair",
    "at\ns",
    "apart\nm",
)


def print_flight(report: Mapping[str, Any]) -> None:
    """The table of effects, and in sentences the conditions, the fuel and the verdict."""
    typer.echo(_about(report["conditions"]))
    rows = report["effects"]
    safe = report["collision_radius"]
    near = [k for k, row in enumerate(rows) if (row["min_separation_bound"] or safe + 1) <= safe]
    print_table(HEADINGS, [_cells(row) for row in rows], marked=near)
    typer.echo(f"Δv is {number(report['delta_v'])} m/s, as planned.")
    typer.echo(_verdict(report))


def _about(conditions: Mapping[str, Any]) -> str:
    held = conditions["ballistic"]
    pulled = f"drag of {held:g} m²/kg ± {conditions['spread']:.0%}" if held else "without drag"
    return (
        f"Eccentricity {conditions['eccentricity']:g}, inclination "
        f"{conditions['inclination_deg']:g}°, {'with' if conditions['j2'] else 'without'} J2, "
        f"{pulled}."
    )


def _cells(row: Mapping[str, Any]) -> list[str]:
    pair, plan = row["min_separation_pair"], row["effect"] == "plan"
    closest = [MISSING] * 3
    if pair is not None:
        at, apart = row["min_separation_time"], row["min_separation"]
        closest = [f"{pair[0]},{pair[1]}", f"{at:.0f}", f"{apart:.2f}"]
    return [
        "linear model" if plan else f"+ {row['effect']}",
        error(row["goal_error"]),
        error(1e3 * row["goal_velocity_error"]),
        MISSING if plan else error(row["added_error"]),
        MISSING if plan else f"{row['share']:.0%}".replace("-0%", "0%"),
        *closest,
    ]


def _verdict(report: Mapping[str, Any]) -> str:
    """How far off the goal, and whether any pair comes too close."""
    miss = (
        f"At worst, craft {report['goal_error_craft']} ends {error(report['goal_error'])} m from "
        "its goal"
    )
    pair, radius = report["min_separation_pair"], report["collision_radius"]
    if report["safe"]:
        return f"{miss}. No pair comes within {radius:g} m."
    return (
        f"{miss}. Not safe: craft {pair[0]} and {pair[1]} come within "
        f"{report['min_separation']:.2f} m of each other; collision_radius is {radius:g} m."
    )
