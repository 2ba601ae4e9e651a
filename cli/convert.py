"""Commands that write a plan in other forms: files of other tools, and a page to look at."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from cli.app import FAILED, not_over, within_memory
from cli.output import echo
from cli.settings import PlanFile, option
from pipeline.errors import InputError
from pipeline.files import STDIO, stem_of

Form = Literal["oem", "csv", "parquet"]


def convert(
    plan: PlanFile,
    to: Annotated[Form, option("Format.")],
    out: Annotated[
        Path | None,
        option("A file, for OEM a folder, for CSV also -; by default named as the plan."),
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
    from pipeline.plan.document import read_plan

    made = read_plan(plan)
    beside = plan if plan == STDIO else plan.with_suffix("" if to == "oem" else f".{to}")
    target = out or beside
    if target == STDIO and to != "csv":
        raise InputError(f"{to} is no text for standard output; expected a name: give --out.")
    not_over(plan, target)
    if target.is_dir() != (to == "oem") and target.exists():
        kind = "a folder" if to == "oem" else "a file"
        raise InputError(f"{target} is there already; expected {kind} for {to}: give --out.")
    try:
        if to == "oem":
            files = write_ephemerides(made, target, stem_of(plan))
            echo(f"{target}: {len(files)} files, one a craft, in EME2000.")
        else:
            (write_csv if to == "csv" else write_parquet)(made, target)
            of = made.scenario
            about = f"{target}: {of.n} craft at {of.problem.nodes} nodes."
            echo(about, err=target == STDIO)
    except InputError as error:
        raise InputError(f"{plan}: {error}") from error
    if made.separation == "nodes":
        echo(f"prolearn: {plan} keeps craft apart at the nodes only, as was asked.", err=True)
    if made.status != SOLVED:
        echo(f"prolearn: {plan} is {made.status}: {made.message}", err=True)
        raise typer.Exit(FAILED)


def show(
    plan: PlanFile,
    out: Annotated[
        Path | None, option("Page to write, - for standard output; PLAN.html by default.")
    ] = None,
) -> None:
    """Write one HTML page that shows a plan and opens without a network.

    The craft on their paths, with a slider for the time; the passive orbits at both ends; the
    separation of the closest pairs, r_col and what is proven; the controls; the certificate. All
    is computed anew from the plan's controls, and what is wrong with a plan stands at the top.

    Examples:

        prolearn show plan.json
        prolearn show plan.json --out plan.html
    """
    from pipeline.plan.document import read_plan
    from pipeline.show import write_page

    target = out or (STDIO if plan == STDIO else plan.with_suffix(".html"))
    not_over(plan, target)
    if target.is_dir():
        raise InputError(f"--out is the folder {target}; expected the name of a page: plan.html.")
    with within_memory():
        claimed = read_plan(plan)
        try:
            shown = write_page(target, claimed, plan.name)
        except InputError as error:
            raise InputError(f"{plan}: {error}") from error
    said = " ".join([f"{target}: {claimed.scenario.n} craft by {claimed.planner}.", *shown.faults])
    echo(said, err=target == STDIO)
