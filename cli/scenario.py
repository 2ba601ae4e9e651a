"""Commands about scenario files: new, check, schema."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.padding import Padding
from rich.table import Column, Table

from cli.app import FAILED, CommandGroup, within_memory
from cli.options import refuse, with_settings
from cli.output import echo, plain_text, print_json, stdout_free, wide_console
from cli.settings import (
    ANGLES,
    AsJson,
    Family,
    InertialFiles,
    OrbitPlace,
    ProblemSettings,
    ThrustSettings,
    option,
)
from pipeline.errors import InputError
from pipeline.files import refuse_dataset, refuse_special
from pipeline.text import as_argument

if TYPE_CHECKING:
    from pipeline.scenario import Diagnostic, Scenario

app = typer.Typer(
    name="scenario",
    cls=CommandGroup,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    help="""Scenario files: write one, check one, describe their fields.

    Each end of a scenario is raw states, or rings of passive relative orbits.

    Examples:

        prolearn scenario new scenario.json --family tilt-split --n 8
        prolearn scenario check scenario.json
    """,
)

MOST_CASES = 5  # faults of a kind that the table shows, the worst ones

EITHER = "expected --from and --to for rings of your own, or neither for a draw of a family."
DRAWN = ("family", "n", "seed", "index", "split")  # options of a draw
OF_ORBITS = ("argument_of_perigee_deg", "no_j2")  # options that a circular orbit has no use for
DRAG = ("ballistic", "spread")  # options for scenarios from inertial states only
SHAPE = ("eccentricity", "argument_of_perigee_deg")
# Options that inertial states have no use for
NOT_INERTIAL = (*DRAWN, "start", "to", "altitude", *ANGLES, *SHAPE)


@app.command()
@with_settings
def new(
    context: typer.Context,
    scenario: Annotated[Path, typer.Argument(help="File to write; - is standard output.")],
    *,
    family: Family = "rings",
    n: Annotated[int, option("Spacecraft to draw.")] = 10,
    seed: Annotated[int, option("Root seed of the draw.")] = 0,
    index: Annotated[int, option("Number of the draw in its split.")] = 0,
    split: Annotated[str, option("Of the draw: train, valid or test.")] = "test",
    start: Annotated[
        list[str] | None,
        option(
            "Instead: craft that start on a ring, by its fields, such as "
            "craft=4,size=200,tilt_deg=20. Repeat the option for more rings.",
            "--from",
            metavar="RING",
        ),
    ] = None,
    to: Annotated[list[str] | None, option("Where they go, likewise.", metavar="RING")] = None,
    problem: ProblemSettings,
    thrust: ThrustSettings,
    place: OrbitPlace,
    files: InertialFiles,
    force: Annotated[bool, option("Replace a file that is there already.", "--force")] = False,
) -> None:
    """Write a scenario file: a draw of a family, rings or inertial states of your own.

    A draw is a function of family, n, seed, split and index, the same as in datasets, and is
    written as raw states. Rings stay rings in the file, to be edited: size in m, tilt_deg, craft
    (equally spaced) from first_phase_deg, cross_phase_deg, offset in m along-track.

    States of --initial and --goal are inertial and become relative to a reference orbit: that of
    --chief, or of the mean of the craft. Each is a folder of orbit ephemeris messages, as
    `prolearn convert --to oem` writes them, a single message, or a table of states or osculating
    elements, whose columns are in docs/files.md. Messages are read at the first and last node.

    Examples:

        prolearn scenario new s.json --family tilt-split --n 8 --seed 3
        prolearn scenario new s.json --from craft=4,size=200 --to craft=4,size=90
        prolearn scenario new s.json --eccentricity 0.01 --inclination 51.6
        prolearn scenario new s.json --initial now --goal then --chief chief.oem
        prolearn scenario new s.json --initial a.csv --goal b.csv --nodes 21
        prolearn scenario new s.json --thrust norm --max-acceleration-norm 0.01
        prolearn scenario new s.json --min-delta-v 0.002 --no-burn 300:500
    """
    from pipeline.scenario import draw
    from pipeline.scenario.document import document_of, scenario_from, write_by_hand
    from pipeline.scenario.part_documents import OrbitDocument

    if scenario.is_dir():
        raise InputError(f"{scenario} is a folder; expected the name of a file.")
    refuse_special(scenario)
    refuse_dataset(scenario)
    if scenario.exists() and not force:
        raise InputError(f"{scenario} exists; expected a new name, or --force to replace it.")
    asked, content = problem.problem(), asdict(problem)
    if files.initial or files.goal or files.chief:
        why = "with inertial states, which have craft and an orbit of their own; leave it out."
        refuse(context, NOT_INERTIAL, why)
        made = files.scenario(asked, place.epoch, j2=not place.no_j2)
        content = {**document_of(made), **thrust.fields(made.n)}
        _say_written(scenario, write_by_hand(scenario, content))
        return
    refuse(context, DRAG, "without --initial; leave it out, or add --initial and --goal.")
    orbit = None
    if place.eccentricity is None:
        why = "without --eccentricity or --initial; expected one of them, such as 0.001."
        refuse(context, OF_ORBITS, why)
    else:
        orbit = place.orbit(content.pop("altitude"))
        asked, content["orbit"] = asked.about(orbit), OrbitDocument.of(orbit).model_dump()
    if start and to:
        refuse(context, DRAWN, f"with rings of your own; {EITHER}")
        content |= {"initial": _rings("--from", start), "goal": _rings("--to", to)}
    elif start or to:
        raise InputError(f"--from or --to alone is given; {EITHER}")
    else:
        draft = draw(family, seed, n, index, asked, split)
        content |= {"initial": draft.initial.tolist(), "goal": draft.goal.tolist()}
    if known := place.fields(orbit):
        content["reference"] = known
    content |= thrust.fields(scenario_from(content, "").n)
    _say_written(scenario, write_by_hand(scenario, content))


def _say_written(scenario: Path, made: "Scenario") -> None:
    if stdout_free(scenario, as_json=False):
        check = f"prolearn scenario check {as_argument(scenario)}"
        echo(f"{scenario}: {_about(made)}; check it: {check}")


def _rings(option: str, given: list[str]) -> Mapping[str, Any]:
    rings = []
    for text in given:
        fields = [part.partition("=") for part in text.split(",")]
        ring: dict[str, float | str] = {name.strip(): value.strip() for name, _, value in fields}
        if not all(name and value for name, _, value in fields) or len(ring) < len(fields):
            raise InputError(
                f"{option} is {text!r}; expected fields of a ring, each once: craft=4,size=200."
            )
        for name, value in ring.items():
            with suppress(ValueError):  # reading the file refuses text that is no number
                ring[name] = float(value)
        rings.append(ring)
    return {"rings": rings}


def _about(scenario: "Scenario") -> str:
    problem, long = scenario.problem, scenario.problem.duration
    duration = f"{long / 60:g} min" if long >= 60 else f"{long:g} s"
    return (
        f"{scenario.n} craft, {duration} in {problem.intervals} intervals of "
        f"{problem.time_step:g} s, collision_radius {problem.collision_radius:g} m"
    )


@app.command()
def check(
    scenario: Annotated[Path, typer.Argument(help="Scenario file; - is standard input.")],
    as_json: AsJson = False,
) -> None:
    """Validate a scenario: report every rule, violated or not, and by how much.

    At both ends: pairs too close, craft that drift (Eq. 3), pairs that come too close in an orbit
    of free drift. Of the transfer: craft whose thrust limit is too low; the least thrust, burn
    intervals and Δv that each needs on its own; and the error of the linear model. Exit status 0:
    all is fine; 1: something is wrong; 2: the file cannot be read.

    Examples:

        prolearn scenario check scenario.json
        prolearn scenario check scenario.json --json
    """
    from pipeline.scenario import diagnostics
    from pipeline.scenario.document import read_scenario

    asked = read_scenario(scenario)
    with within_memory():
        found = diagnostics(asked)
    fine = all(finding.fine for finding in found)
    if as_json:
        listed = [{**asdict(finding), "fine": finding.fine} for finding in found]
        print_json({"scenario": str(scenario), "fine": fine, "findings": listed})
    else:
        echo(f"{scenario}: {_about(asked)}", "")
        _show(found)
    raise typer.Exit(0 if fine else FAILED)


def _show(found: "list[Diagnostic]") -> None:
    console, rules = wide_console(), max(len(finding.rule) for finding in found)
    for finding in found:
        columns = [Column(overflow="fold") for _ in range(4)]
        row = Table(*columns, box=None, show_header=False, padding=(0, 2, 0, 0), pad_edge=False)
        verdict = ("fine ", "green") if finding.fine else ("wrong", "bold red")
        end, rule = plain_text(f"{finding.end:8}"), plain_text(f"{finding.rule:{rules}}")
        row.add_row(end, rule, plain_text(*verdict), plain_text(finding.text))
        console.print(row)
        lines = [case.text for case in finding.cases[:MOST_CASES]]
        if len(finding.cases) > MOST_CASES:
            lines.append(f"and {len(finding.cases) - MOST_CASES} more, which --json has")
        if finding.cure:
            lines.append(f"to mend it, {finding.cure}")
        for line in lines:
            console.print(Padding(plain_text(line), (0, 0, 0, 4), expand=False))


@app.command()
def schema(plan: Annotated[bool, option("Of plan files instead.", "--plan")] = False) -> None:
    """Print the JSON Schema of scenario files: every field, its type and its unit.

    Editors that know it complete fields and mark mistakes while one types.

    Examples:

        prolearn scenario schema
        prolearn scenario schema --plan
    """
    if plan:
        from pipeline.plan.document import json_schema as made
    else:
        from pipeline.scenario.document import json_schema as made
    print_json(made())
