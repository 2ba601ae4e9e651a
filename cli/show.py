"""The command that makes a plan a page to look at."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.errors import InputError


def show(
    plan: Annotated[Path, typer.Argument(help="Plan file.", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Page to write; by default beside the plan, with the suffix .html.",
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
    from pipeline.plan.document import read_plan
    from pipeline.show import write_page

    target = out or plan.with_suffix(".html")
    if target.is_dir() or (target.exists() and plan.exists() and target.samefile(plan)):
        what = "a folder" if target.is_dir() else "the plan itself"
        raise InputError(f"--out is {target}, {what}; expected the name of a page, as plan.html.")
    claimed, scenario = read_plan(plan)
    if scenario is None:
        raise InputError(
            f"{plan} has schema prolearn.plan/1, which leaves out the scenario that the page is "
            "to show; expected prolearn.plan/2: plan again with `prolearn plan`."
        )
    try:
        shown = write_page(target, claimed, scenario, plan.name)
    except InputError as error:
        raise InputError(f"{plan}: {error}") from error
    typer.echo(" ".join([f"{target}: {scenario.n} craft by {claimed.planner}.", *shown.faults]))
