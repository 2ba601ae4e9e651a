"""The command that makes a plan a page to look at."""

from pathlib import Path
from typing import Annotated

import typer

from cli.app import not_over
from cli.memory import within_memory
from cli.output import echo
from pipeline.errors import InputError
from pipeline.files import STDIO


def show(
    plan: Annotated[
        Path, typer.Argument(help="Plan file; - is standard input.", show_default=False)
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Page to write, - for standard output; by default beside the plan, with the "
            "suffix .html.",
            show_default=False,
        ),
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
    from pipeline.plan.document import read_whole_plan
    from pipeline.show import write_page

    target = out or (STDIO if plan == STDIO else plan.with_suffix(".html"))
    not_over(plan, target)
    if target.is_dir():
        raise InputError(f"--out is the folder {target}; expected the name of a page: plan.html.")
    with within_memory():
        claimed, scenario = read_whole_plan(plan)
        try:
            shown = write_page(target, claimed, scenario, plan.name)
        except InputError as error:
            raise InputError(f"{plan}: {error}") from error
    said = " ".join([f"{target}: {scenario.n} craft by {claimed.planner}.", *shown.faults])
    echo(said, err=target == STDIO)
