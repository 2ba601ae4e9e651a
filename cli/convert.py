"""The command that hands a plan over to other tools."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from cli.app import FAILED, not_over
from cli.output import echo
from pipeline.errors import InputError
from pipeline.files import STDIO, stem_of


class Form(StrEnum):
    """What a plan can become."""

    OEM = "oem"
    CSV = "csv"
    PARQUET = "parquet"


def convert(
    plan: Annotated[
        Path, typer.Argument(help="Plan file; - is standard input.", show_default=False)
    ],
    to: Annotated[Form, typer.Option(help="Format.", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option(
            help="A file, for OEM a folder, for CSV also - for standard output; by default the "
            "plan's name with the format's ending.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Write a plan in a format that other tools read.

    OEM: a CCSDS orbit ephemeris message for each craft, with a segment for each thrust arc, in
    EME2000; the scenario must say where its reference orbit is. CSV and Parquet: a row for each
    craft and node, in LVLH. A plan that is not safe is written too, and the exit status is 1.

    Examples:

        prolearn convert plan.json --to oem --out ephemerides
        prolearn convert plan.json --to parquet
    """
    from pipeline.export import write_csv, write_ephemerides, write_parquet
    from pipeline.plan import SOLVED
    from pipeline.plan.document import read_whole_plan

    made, scenario = read_whole_plan(plan)
    target = out or _default(plan, to)
    if target == STDIO and to != Form.CSV:
        raise InputError(f"{to} is no text for standard output; expected a name: give --out.")
    not_over(plan, target)
    if target.is_dir() != (to == Form.OEM) and target.exists():
        kind = "a folder" if to == Form.OEM else "a file"
        raise InputError(f"{target} is there already; expected {kind} for {to}: give --out.")
    try:
        if to == Form.OEM:
            files = write_ephemerides(made, scenario, target, stem_of(plan))
            echo(f"{target}: {len(files)} files, one a craft, in EME2000.")
        else:
            (write_csv if to == Form.CSV else write_parquet)(made, scenario, target)
            about = f"{target}: {scenario.n} craft at {scenario.problem.nodes} nodes."
            echo(about, err=target == STDIO)
    except InputError as error:
        raise InputError(f"{plan}: {error}") from error
    if made.separation == "nodes":
        echo(f"prolearn: {plan} keeps craft apart at the nodes only, as was asked.", err=True)
    if made.status != SOLVED:
        echo(f"prolearn: {plan} is {made.status}: {made.message}", err=True)
        raise typer.Exit(FAILED)


def _default(plan: Path, to: Form) -> Path:
    """Where a plan goes that is told no place."""
    if plan == STDIO:
        return STDIO
    return plan.with_suffix("" if to == Form.OEM else f".{to}")
