"""The command that says how long a transfer should take."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from cli.app import told_if_stopped, within_memory
from cli.options import with_settings
from cli.output import echo, print_json, print_table
from cli.plan_table import HEADINGS, cells, who, wrong
from cli.progress import progress
from cli.settings import AsJson, Tradeoff
from pipeline.errors import InputError
from pipeline.figures.labels import MISSING, number
from pipeline.files import stem_of

UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}  # units of a duration, s

NUMBER = r"(\d+(?:\.\d+)?)"
RANGE = re.compile(rf"\s*{NUMBER}\s*\.\.\s*{NUMBER}\s*({'|'.join(UNITS)})\s*")


@with_settings
def tradeoff(
    scenario: Annotated[Path, typer.Argument(help="Scenario file.")],
    settings: Tradeoff,
    as_json: AsJson = False,
) -> None:
    """Fuel against transfer time: certified plans, their lower bound, and the knee.

    Thrust arcs keep the scenario's time_step and their number varies, so each duration is a whole
    number of arcs. Into the folder go the safe plans, tradeoff.csv and a figure. The knee is
    where the curve of Δv is furthest below the line between its ends, both scaled to 0..1
    (Kneedle), if that is a tenth at least and a minute saves half as much after it as before, or
    less; else there is none. The exit status is 1 where no duration has a safe
    plan.

    Examples:

        prolearn tradeoff scenario.json --duration 10..60min
        prolearn tradeoff scenario.json --duration 600..3600s --steps 11 --json
        prolearn tradeoff scenario.json --duration 1..3h --goal moving --out trade/
    """
    durations = seconds(settings.duration)
    from cli.jobs.planner import planner_of
    from cli.jobs.tradeoff import trade
    from pipeline.plan import Requirements

    required, assignment = Requirements(settings.separation), settings.assignment
    planner = planner_of(settings.planner, required, settings.effort, assignment=assignment)
    folder = settings.out or Path(f"{stem_of(scenario)}-tradeoff")
    stopped = told_if_stopped(lambda: "the trade-off is not complete.")
    with stopped, progress("planning") as shown, within_memory():
        rows = trade(scenario, planner, folder, settings, durations, shown)
    if as_json:
        print_json({"scenario": str(scenario), "goal": settings.goal, "points": rows})
    else:
        _print_curve(rows, folder)
    raise typer.Exit(int(all(wrong(row) for row in rows)))


def seconds(text: str) -> tuple[float, float]:
    """A range of durations, s, written as 10..60min, 600..3600s or 1..3h, or an InputError."""
    found = RANGE.fullmatch(text)
    if found is None or not 0 < float(found[1]) < float(found[2]):
        raise InputError(
            f"--duration is {text!r}; expected a range from less to more with its unit, such as "
            "10..60min, 600..3600s or 1..3h."
        )
    unit = UNITS[found[3]]
    return float(found[1]) * unit, float(found[2]) * unit


def _print_curve(rows: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """The table, why durations have no safe plan, the knee, and where the files are."""
    lines = []
    for row in rows:
        bound = row["delta_v_lower_bound"]
        least = MISSING if bound is None else number(bound)
        mark = "knee" if row["knee"] else ""
        lines.append([_minutes(row), who(row), *cells(row), least, mark])
    headings = ("transfer\nmin", "planner", *HEADINGS, "bound\nm/s", "")
    print_table(
        headings, lines, texts=(0, 1), marked=[k for k, row in enumerate(rows) if wrong(row)]
    )
    for row in rows:
        if wrong(row):
            echo(f"{_minutes(row)} min: {row['status']}: {row['message']}")
    bent = [row for row in rows if row["knee"]]
    for row in bent:
        echo(f"The knee is at {_minutes(row)} min, {number(row['delta_v'])} m/s.")
    if not bent:
        echo(
            "There is no knee: too few plans are safe, or more time saves about as much everywhere."
        )
    echo(f"Plans, tradeoff.csv and the figure are in {folder}/.")


def _minutes(row: Mapping[str, Any]) -> str:
    return f"{row['duration'] / 60:.4g}"
