"""The command that flies a plan outside the linear model, once or many times with errors."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.app import FAILED, within_memory
from cli.options import refuse, with_settings, workers_of
from cli.output import echo, note, print_json, print_table
from cli.plan_table import CLOSEST, SIGNED, closest_cells, orbit_in_words
from cli.progress import progress
from cli.settings import AsJson, FlightConditions, FlownTrials, PlanFile, WorkerSettings, option
from pipeline.errors import InputError, error_context
from pipeline.figures.labels import MISSING, error, number, percents, share
from pipeline.files import stem_of

if TYPE_CHECKING:
    from pipeline.flight.errors import Errors
    from pipeline.flight.summary import Summary
    from pipeline.flight.world import Conditions
    from pipeline.parallel.workers import Workers
    from pipeline.plan.plan import Plan
    from pipeline.plan.requirements import Requirements


@with_settings
def fly(
    context: typer.Context,
    plan: PlanFile,
    conditions: FlightConditions,
    settings: FlownTrials,
    workers: WorkerSettings,
    passive_safety: Annotated[
        float | None,
        option(
            "Also look for craft that lost thrust at a node and drift for so many orbits.",
            metavar="ORBITS",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Fly a plan's controls about an oblate Earth: errors at the goals and closest approach.

    Craft move under two-body gravity, J2 and, if asked for, drag, about a reference orbit that
    need not be a circle. The table has a row for each effect, added to those above it: the largest
    error at a goal, what the effect added to it at most, its share of the final error, and which
    pair comes closest when. Exit status 0: no pair comes within r_col at any time, or at the nodes
    for a plan with separation at these only; 1: one does; 2: bad input. With radii of craft or
    obstacles clearances decide instead, and with corridors craft must also stay inside of them.

    With `--trials` the plan is flown that many times with errors of thrust, timing and navigation,
    in open loop; with `--replan feedback` also with deviations corrected at every node; with
    `--replan every-node` also replanned at every node from estimated states, without and with a
    margin. The table has how often a pair comes within r_col, with Wilson's intervals, errors at
    the goal and Δv; the folder has the trials, the table and a figure. Obstacles have no errors.
    Plans with radii, obstacles, corridors, waypoints or thrust fields other than max_acceleration
    are flown in open loop only. With `--error lost=1` a random craft loses its thrust at a random
    time of each trial, and the others replan around its drift. After a kill or an interruption
    the same command continues; the exit status is 0 when all is flown.

    Examples:

        prolearn fly plan.json
        prolearn fly plan.json --eccentricity 0.005 --inclination 51.6
        prolearn fly plan.json --drag 0.01 --drag-spread 0.2
        prolearn fly plan.json --eccentricity 0 --no-j2 --json
        prolearn fly plan.json --passive-safety 1
        prolearn fly plan.json --trials 1000 --replan every-node
        prolearn fly plan.json --trials 1000 --replan feedback
        prolearn fly plan.json --trials 1000 --replan every-node --error lost=1
        prolearn fly plan.json --trials 1000 --error missed=0.01 --out flown/
        prolearn fly plan.json --trials 1000 --world linear --device cuda
    """
    from pipeline.flight.effects import effects, flight_report
    from pipeline.plan.document import read_plan

    if settings.trials is None:
        for group in (FlownTrials, WorkerSettings):
            refuse(context, group, "without --trials; expected both: add --trials 1000.")
    else:
        refuse(context, ("passive_safety",), "with --trials, which have errors; leave it out.")
    if settings.replan != "every-node":
        why = "and nobody plans anew; add --replan every-node."
        refuse(context, ("planner", "effort", "sigmas"), why)
    if settings.world == "linear":
        refuse(context, FlightConditions, "and the linear world has no such thing; leave it out.")
    else:
        refuse(context, ("device",), "and the nonlinear world has none; add --world linear.")
    with within_memory():
        made = read_plan(plan)
    about = conditions.about(made.scenario)
    if made.scenario.problem.orbit is not None:
        refuse(context, FlightConditions, "and the plan has an orbit of its own: leave it out.")
    if settings.trials is not None:
        flying = workers_of(context, workers)
        _fly_trials(plan, made, about, settings, flying, as_json=as_json)
        return
    with error_context(plan), within_memory():
        found = effects(made.scenario, made.controls, about)
    report = {"plan": str(plan), **flight_report(made, about, found, passive_safety)}
    print_json(report) if as_json else print_flight(report)
    raise typer.Exit(0 if report["safe"] else FAILED)


def _fly_trials(
    path: Path,
    plan: "Plan",
    conditions: "Conditions",
    settings: FlownTrials,
    workers: "Workers",
    *,
    as_json: bool,
) -> None:
    from cli.jobs.fly_trials import fly_trials

    errors = errors_of(settings.errors, settings.error or [])
    folder = settings.out or Path(f"{stem_of(path).removesuffix('.plan')}-flown")
    with progress("flying") as shown, within_memory():
        by = workers.with_progress(shown)
        loops = fly_trials(plan, conditions, errors, folder, settings, workers=by)
    required = plan.requirements if settings.replan == "every-node" else None
    if as_json:
        about = {"plan": str(path), "folder": str(folder)}
        told = [one.document() for one in loops]
        print_json({**about, "loops": told, "requirements": required})
        return
    print_trials(loops, plan.scenario.problem.collision_radius, settings.size)
    if required is not None:
        note(*_replanned_for(required))
    if errors.lost > 0:
        note(f"A craft is lost with probability {errors.lost:g}; errors at goals are of others.")
    echo(f"The trials, trials.csv and the figure are in {folder}/.")


def errors_of(preset: str, changes: Sequence[str]) -> "Errors":
    """The errors of a preset, of PRESETS, with some of them changed as in NAME=VALUE."""
    from pipeline.flight.errors import PRESETS

    errors, names = PRESETS[preset], [field.name for field in fields(PRESETS[preset])]
    for change in changes:
        name, _, text = change.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = None
        if name not in names or value is None:
            raise InputError(
                f"--error is {change!r}; expected NAME=VALUE with a name of {', '.join(names)}, "
                "such as magnitude=0.05."
            )
        errors = replace(errors, **{name: value})
    return errors


def _replanned_for(required: "Requirements") -> Iterator[str]:
    """A sentence on requirements of replanning other than separation at all times, if any."""
    if required.at_nodes:
        yield "Replanned, craft are kept apart at the nodes only, as in the plan."
    elif required.passive_safety is not None:
        yield (
            "Replanned, craft also stay clear of any that loses its thrust at a node, as in the "
            f"plan. Orbits of drift: {required.passive_safety:g}. Nodes without a safe plan are "
            "those at which this, or r_col, could not be kept from the estimated states."
        )


HEADINGS = ("flown with", "off goal\nm", "\nmm/s", "added\nm", "share", *CLOSEST)


def print_flight(report: Mapping[str, Any]) -> None:
    """The table of effects, and in sentences the conditions, the fuel and the verdict."""
    rows, radius = report["effects"], report["collision_radius"]
    said = orbit_in_words(report["conditions"])
    note(said[0].upper() + said[1:])
    bad = [k for k, row in enumerate(rows) if _too_close(row, radius) or _is_outside(row)]
    print_table(HEADINGS, [_cells(row) for row in rows], marked=bad)
    if "clearance" in report:
        note(SIGNED)
    worst, off = report["goal_error_craft"], error(report["goal_error"])
    ends = f"At worst, craft {worst} ends {off} m from its goal."
    verdict = " ".join([*_drift(report), ends, *_corridor(report), _separation(report)])
    note(f"Δv is {number(report['delta_v'])} m/s, as planned.", verdict)


def _too_close(row: Mapping[str, Any], radius: float) -> bool:
    """Whether a pair, or a craft and an obstacle, come too close in a flight or a drift."""
    if clear := row.get("clearance"):
        return bool(clear["min_clearance_bound"] <= 0)
    bound = row["min_separation_bound"]  # None of a craft alone
    return bound is not None and bound <= radius


def _is_outside(row: Mapping[str, Any]) -> bool:
    return "corridor" in row and row["corridor"]["min_margin_bound"] <= 0


def _cells(row: Mapping[str, Any]) -> list[str]:
    plan = row["effect"] == "plan"
    return [
        "linear model" if plan else f"+ {row['effect']}",
        error(row["goal_error"]),
        error(1e3 * row["goal_velocity_error"]),
        MISSING if plan else error(row["added_error"]),
        MISSING if plan or row["share"] is None else f"{row['share']:z.0%}",
        *closest_cells(row),
    ]


def _drift(report: Mapping[str, Any]) -> Iterator[str]:
    drift = report["passive_safety"] or {}
    if clear := drift.get("clearance"):
        node, what = clear["node"], _clearance(clear)
    elif drift.get("pair"):
        node, (i, j) = drift["node"], drift["pair"]
        what = f"craft {i} comes within {drift['min_separation']:.2f} m of craft {j}"
    else:
        return
    orbits = f"{drift['orbits']:g} orbit{'s' * (drift['orbits'] != 1)}"
    verdict = "Not passively safe: " if _too_close(drift, report["collision_radius"]) else ""
    yield f"{verdict}Adrift for {orbits} from node {node}, {what}."


def _corridor(report: Mapping[str, Any]) -> Iterator[str]:
    if found := report.get("corridor"):
        by, where = found["min_margin"], f"corridors[{found['corridor']}] at {found['time']:.0f} s"
        kept = "Not kept: craft" if _is_outside(report) else "Craft"
        yield f"{kept} {found['craft']} is {abs(by):.2f} m {'in' if by > 0 else 'out'}side {where}."


def _separation(report: Mapping[str, Any]) -> str:
    radius, clear = report["collision_radius"], report.get("clearance")
    if not _too_close(report, radius):
        if clear:
            return f"{_clearance(clear).replace('craft', 'Craft', 1)}, the least of all."
        return f"No pair comes within {radius:g} m."
    if clear:
        what = _clearance(clear)
    else:
        i, j = report["min_separation_pair"]
        what = (
            f"craft {i} and {j} come within {report['min_separation']:.2f} m of each other; "
            f"collision_radius is {radius:g} m"
        )
    kept = report.get("node_collisions") == 0
    said = "No pair is too close at a node, and no more was asked" if kept else "Not safe"
    return f"{said}: {what}."


def _clearance(of: Mapping[str, Any]) -> str:
    """The clearance between a craft and another, or an obstacle, in words."""
    other = f"craft {of['other']}" if isinstance(of["other"], int) else of["other"]
    by, craft = of["min_clearance"], f"craft {of['craft']}"
    if by > 0:
        return f"{craft} keeps clear of {other} by {by:.2f} m"
    return f"{craft} comes {-by:.2f} m too close to {other}"


def print_trials(summaries: "Sequence[Summary]", radius: float, size: float) -> None:
    """Print a column for each loop and a row for each quantity; three loops fit 80 characters."""
    sized = summaries[0].least_clearance is not None
    shares = {
        "too close by sizes" if sized else f"within r_col, {radius:g} m": "within_radius",
        f"within {size:g} m": "within_size",
    }
    if summaries[0].outside_corridor is not None:
        shares["outside a corridor"] = "outside_corridor"
    lines = [[label, *(_share(one, name) for one in summaries)] for label, name in shares.items()]
    for label, name, text in QUANTITIES:
        values = [getattr(one, name) for one in summaries]
        if any(value is not None for value in values):
            lines.append([label, *(MISSING if v is None else text(v) for v in values)])
    count = summaries[0].trials
    headings = [
        f"{count} trial{'s' * (count != 1)}",
        *(one.loop.replace(", ", ",\n") for one in summaries),
    ]
    print_table(headings, lines, folded=True)


# Label, field of a summary, and how it is written
QUANTITIES: Sequence[tuple[str, str, Callable[[float], str]]] = (
    ("least separation, m: median", "separation_median", number),
    ("  least of all", "least_separation", number),
    ("clearance, m: median", "clearance_median", number),
    ("  least of all", "least_clearance", number),
    ("inside corridors by, m: median", "corridor_median", number),
    ("  least of all", "least_corridor", number),
    ("error at goal, m: median", "goal_error_median", error),
    ("  95 %", "goal_error_high", error),
    ("  mm/s: median", "goal_velocity_error_median", lambda v: error(1e3 * v)),
    ("  95 %", "goal_velocity_error_high", lambda v: error(1e3 * v)),
    ("Δv, m/s: median", "delta_v_median", number),
    ("  95 %", "delta_v_high", number),
    ("missed burns a trial", "missed_burns", number),
    ("margin, σ", "sigmas", number),
    ("nodes without a safe plan", "unsafe_replans", number),
    ("time a replan, ms: median", "replan_seconds", lambda v: number(1e3 * v)),
)


def _share(one: "Summary", name: str) -> str:
    value, interval = getattr(one, name), getattr(one, f"{name}_interval")
    return MISSING if value is None else f"{share(value)} {percents(*interval)}"
