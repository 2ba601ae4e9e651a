"""The command that flies a plan outside the linear model."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from pipeline.flight.conditions import Conditions
    from pipeline.plan import Plan, Requirements
    from pipeline.scenario import Scenario

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
from cli.memory import within_memory
from cli.output import AsJson, echo, print_json, print_table
from cli.plan import planner_of
from cli.progress import progress
from cli.trials import (
    CONDITIONS,
    OF_REPLANNING,
    OF_TRIALS,
    Changed,
    Jobs,
    Margin,
    Out,
    Preset,
    Replan,
    ReplanEffort,
    Replanner,
    Seed,
    Size,
    Trials,
    WorldKind,
    errors_of,
    print_trials,
    refuse,
)
from pipeline.errors import InputError
from pipeline.figures.labels import MISSING, error, number
from pipeline.files import stem_of


def fly(
    context: typer.Context,
    plan: Annotated[
        Path, typer.Argument(help="Plan file; - is standard input.", show_default=False)
    ],
    eccentricity: Eccentricity = 0.001,
    inclination: Inclination = None,
    raan: Raan = None,
    argument_of_perigee: ArgumentOfPerigee = 90.0,
    argument_of_latitude: ArgumentOfLatitude = None,
    no_j2: NoJ2 = False,
    drag: DragOn = None,
    drag_spread: DragSpread = None,
    trials: Trials = None,
    seed: Seed = 0,
    errors: Preset = "cold-gas",
    error: Changed = None,
    world: WorldKind = "nonlinear",
    replan: Replan = "none",
    planner: Replanner = "expert",
    effort: ReplanEffort = None,
    margin: Margin = None,
    size: Size = 0.35,
    out: Out = None,
    jobs: Jobs = -1,
    as_json: AsJson = False,
) -> None:
    """Fly a plan's controls about an oblate Earth, and say how far off they lead.

    Every craft is integrated on its own in an inertial frame, from a reference orbit that need
    not be a circle, under two-body gravity, J2 and, if asked for, drag. The table has a row for
    each effect, added to those above it: how far the worst craft then ends from its goal, what
    the effect added at most, its share of the final error, and which pair comes closest when.
    Exit status 0: no pair comes within r_col at any time, or at the nodes where the plan was made
    for these only; 1: one does; 2: bad input.

    With `--trials` it is flown so many times with errors of thrust, timing and navigation, and
    with `--replan every-node` also planned anew from where craft seem to be, without and with a
    margin. The table has how often a pair comes within r_col, with Wilson's intervals, errors
    at the goal and Δv; into the folder go the trials, the table and a figure. Killed or
    interrupted, the same command goes on; the exit status is 0 when all is flown.

    Examples:

        prolearn fly plan.json
        prolearn fly plan.json --eccentricity 0.005 --inclination 51.6
        prolearn fly plan.json --drag 0.01 --drag-spread 0.2
        prolearn fly plan.json --eccentricity 0 --no-j2 --json
        prolearn fly plan.json --trials 1000 --replan every-node
        prolearn fly plan.json --trials 1000 --error missed=0.01 --out flown/
    """
    from pipeline.plan.document import read_whole_plan

    if trials is None:
        refuse(context, OF_TRIALS, "without --trials; expected both: add --trials 1000.")
    elif replan == "none":
        refuse(context, OF_REPLANNING, "and nobody plans anew; add --replan every-node.")
    if world == "linear":
        refuse(context, CONDITIONS, "and the linear world has no such thing; leave it out.")

    with within_memory():
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
    if trials is None:
        _fly_once(plan, made, scenario, conditions, as_json=as_json)
        return
    from cli.stages.fly_trials import fly_trials
    from pipeline.flight.world import LinearWorld

    problem = scenario.problem
    linear = world == "linear"
    flown_in = LinearWorld(problem.dynamics) if linear else conditions.world(problem, scenario.n)
    told = errors_of(errors, error or [])
    replanner = None
    if replan != "none":
        _refuse_risk(made)
        replanner = planner_of(planner, made.requirements, effort)
    with progress("flying") as shown, within_memory():
        done = fly_trials(
            made,
            scenario,
            flown_in,
            told,
            out or Path(f"{stem_of(plan).removesuffix('.plan')}-flown"),
            trials=trials,
            size=size,
            seed=seed,
            planner=replanner,
            margin=margin,
            jobs=jobs,
            progress=shown,
        )
    if as_json:
        required = None if replanner is None else asdict(made.requirements)
        result = {"folder": str(done.folder), "loops": done.summaries, "requirements": required}
        print_json({"plan": str(plan), **result})
        return
    print_trials(done.summaries, problem.collision_radius, size)
    if replanner is not None and (kept := _kept(made.requirements)):
        echo(kept)
    echo(f"The trials, trials.csv and the figure are in {done.folder}/.")


def _refuse_risk(plan: "Plan") -> None:
    """Refuse to plan anew for a risk, which is one of open loop.

    Raises:
        InputError: where the plan was asked for one.
    """
    if (risk := plan.certificate.risk) is not None:
        raise InputError(
            f"the plan was asked for a risk of at most {risk.asked:g} in open loop, which planning "
            "anew does not keep; expected --replan none, or a plan without --risk: --margin is "
            "what keeps craft apart from their errors then."
        )


def _kept(required: "Requirements") -> str:
    """What planning anew keeps other than separation at all times, or nothing."""
    if required.at_nodes:
        return "Planned anew, craft are kept apart at the nodes only, as in the plan."
    if required.passive_safety is None:
        return ""
    return (
        "Planned anew, craft are also kept apart from any that loses its thrust at a node, for "
        f"{required.passive_safety:g} orbits of drift, as in the plan; nodes without a safe plan "
        "are those at which this or r_col was not kept from where craft seemed to be."
    )


def _fly_once(
    path: Path, plan: "Plan", scenario: "Scenario", conditions: "Conditions", *, as_json: bool
) -> None:
    """Fly it without errors, with one effect more each time."""
    from pipeline.flight.effects import effects, flight_report

    try:
        with within_memory():
            found = effects(scenario, plan.controls, conditions)
    except InputError as wrong:
        raise InputError(f"{path}: {wrong}") from wrong
    report = {"plan": str(path), **flight_report(plan, scenario, conditions, found)}
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
    echo(_about(report["conditions"]))
    rows = report["effects"]
    safe = report["collision_radius"]
    near = [k for k, row in enumerate(rows) if (row["min_separation_bound"] or safe + 1) <= safe]
    print_table(HEADINGS, [_cells(row) for row in rows], marked=near)
    echo(f"Δv is {number(report['delta_v'])} m/s, as planned.")
    echo(_verdict(report))


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
    at_nodes = report["separation"] == "nodes"
    if report["safe"] and (pair is None or not at_nodes):
        return f"{miss}. No pair comes within {radius:g} m."
    verdict = (
        "No pair is too close at a node, and no more was asked" if report["safe"] else "Not safe"
    )
    return (
        f"{miss}. {verdict}: craft {pair[0]} and {pair[1]} come within "
        f"{report['min_separation']:.2f} m of each other; collision_radius is {radius:g} m."
    )
