"""Commands that write a plan in other forms: files for other tools, and an HTML page."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from cli.app import FAILED, refuse_overwriting, within_memory
from cli.options import numbers
from cli.output import echo
from cli.settings import PlanFile, option
from pipeline.errors import InputError, error_context
from pipeline.files import STDIO, stem_of, write_text

FormatName = Literal["oem", "opm", "csv", "parquet", "burns", "basilisk"]


def convert(
    plan: PlanFile,
    to: Annotated[
        FormatName, option("oem, opm, csv, parquet, burns or basilisk.", metavar="FORMAT")
    ],
    out: Annotated[
        Path | None, option("A file or -, for OEM and OPM a folder; by default named as the plan.")
    ] = None,
    mass: Annotated[
        str | None,
        option("At the first node, kg: one for all craft, or one,for,each; default: scenario's."),
    ] = None,
    specific_impulse: Annotated[
        str | None, option("Of thrusters, s: one for all craft, or one,for,each.")
    ] = None,
) -> None:
    """Write a plan in a format that other tools read.

    OEM: a CCSDS orbit ephemeris message for each craft, with a segment for each thrust arc, in
    EME2000; the scenario must say where its reference orbit is. OPM: an orbit parameter message
    for each craft, its state at the first node, mass and manoeuvres. CSV and Parquet: a row for
    each craft and node, in LVLH. Burns: a CSV with a row for each craft and interval with thrust.
    Basilisk: a Python script that flies the burns in this simulator (PyPI: bsk), with J2 where
    the plan's orbit has it; the scenario must have an orbit or say where its reference orbit is.
    A plan that is not safe is written too, and the exit status is 1.

    Examples:

        prolearn convert plan.json --to oem --out ephemerides
        prolearn convert plan.json --to opm --mass 12 --specific-impulse 220
        prolearn convert plan.json --to parquet
        prolearn convert plan.json --to burns --out burns.csv
        prolearn convert plan.json --to basilisk --out swarm.py
    """
    from pipeline.export import FORMATS, write_plan_as
    from pipeline.plan.document import read_plan
    from pipeline.plan.plan import SOLVED

    form, folder = FORMATS[to], not FORMATS[to].suffix
    given = {"--mass": mass, "--specific-impulse": specific_impulse}
    masses, isp = (None if text is None else numbers(text, name) for name, text in given.items())
    made = read_plan(plan)
    target = out or (plan if plan == STDIO else plan.with_suffix(form.suffix))
    if target == STDIO and (folder or not form.text):
        raise InputError(f"{to} is no text for standard output; expected a name: give --out.")
    refuse_overwriting(plan, target)
    if target.is_dir() != folder and target.exists():
        there, wanted = ("file", "folder") if folder else ("folder", "file")
        raise InputError(f"{target} is a {there}; expected a {wanted} for {to}: give --out.")
    with error_context(plan):
        files = write_plan_as(to, made, target, stem_of(plan), mass=masses, specific_impulse=isp)
    if folder:
        echo(f"{target}: {len(files)} files, one for each craft, in EME2000.")
    else:
        of = made.scenario
        _tell(target, f"{of.n} craft at {of.problem.nodes} nodes.")
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
    from pipeline.show import page

    with within_memory():
        claimed = read_plan(plan)
    target = out or (STDIO if plan == STDIO else plan.with_suffix(".html"))
    refuse_overwriting(plan, target)
    if target.is_dir():
        raise InputError(f"--out is the folder {target}; expected the name of a page: plan.html.")
    with within_memory(), error_context(plan):
        text, shown = page(claimed, plan.name)
        write_text(target, text)
    _tell(target, " ".join([f"{claimed.scenario.n} craft by {claimed.planner}.", *shown.faults]))


def _tell(target: Path, what: str) -> None:
    """Say what was written; on stderr where the output is on stdout."""
    echo(f"{'stdout' if target == STDIO else target}: {what}", err=target == STDIO)
