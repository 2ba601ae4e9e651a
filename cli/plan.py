"""Commands that plan a scenario of one's own: for its transfer time, or for a range of them."""

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby, islice, product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from unicodedata import normalize

import typer

from cli.app import explained_interrupt, refuse_overwriting, within_memory
from cli.options import refuse, with_settings
from cli.output import echo, note, print_json, stdout_for_document, stdout_free
from cli.plan_table import HEADINGS, is_unsolved, plan_cells, print_plans, print_rows
from cli.progress import progress
from cli.settings import AsJson, FlightConditions, Planning, RiskSettings, Tradeoff, option
from pipeline.errors import InputError, error_context
from pipeline.figures.labels import MISSING, number
from pipeline.files import STDIO, refuse_special, refuse_unwritable, stem_of

if TYPE_CHECKING:
    from pipeline.scenario import Scenario

MOST_AT_ONCE = 50  # scenarios planned at once: between groups plans are written, progress shown
UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}  # units of a duration, s
NUMBER = r"(\d+(?:\.\d+)?)"
RANGE = re.compile(rf"\s*{NUMBER}\s*\.\.\s*{NUMBER}\s*({'|'.join(UNITS)})\s*")


@with_settings
def plan(
    context: typer.Context,
    scenarios: Annotated[list[Path], typer.Argument(help="Scenario files; - is standard input.")],
    out: Annotated[Path, option("Plan file, - for standard output, or a folder for several.")],
    *,
    planning: Planning,
    raw: Annotated[
        bool, option("A model's own plan, safe or not, without the expert after it.", "--raw")
    ] = False,
    risk: RiskSettings,
    passive_safety: Annotated[
        float | None,
        option(
            "Also keep craft apart should any one lose thrust at a node: it drifts for so many "
            "orbits while the others fly on.",
            metavar="ORBITS",
        ),
    ] = None,
    world: Annotated[
        bool,
        option("Plan for the flight about an oblate Earth, with the conditions below.", "--world"),
    ] = False,
    conditions: FlightConditions,
    as_json: AsJson = False,
) -> None:
    """Plan transfers of scenario files, each with a certificate.

    A table has for each plan its planner, fuel and Δv, the gap to the proven lower bound, which
    pair comes closest, when and how close, and the computing time. The exit status is 1 where a
    plan is not safe, and the reason is named.

    The refiner's plan is taken where it is proven safe, else one convex solve follows it, else
    the expert plans; the plan says which. With --effort default or best it seeds the expert
    instead, as the plan of any other model does. So the plan is safe wherever the expert finds a
    safe one; --raw leaves the expert out. The refiner and LSTMs also plan on time grids other
    than that of their training. `refiner` comes with the package; one that was trained here is
    named with its recipe or version, as refiner:tuned.

    With `--assignment optimal` craft are interchangeable, and goals are assigned such that the
    fuel of all is least. The gap is then to the least fuel of any assignment, and the plan file
    says who takes which goal and what that saves at least against any plan in the order given.

    With `--risk` pairs are kept so far apart that, flown in open loop with Gaussian errors in the
    linear model, they come within the collision radius with at most that probability, at any time
    from the first node to the last. The certificate has the bound, and the fuel without it. With
    `--closed-loop` it is the risk of flying with `fly --replan feedback`: at each node deviations
    from the plan are corrected, and the bound counts corrections beyond the thrust limit, too.

    With `--passive-safety` no pair comes within collision_radius either if one craft loses thrust
    at any node and drifts from there for so many orbits, such as 0.5 or 2, while the others fly
    their plan and then drift on from their goals. Where the end states alone forbid it, the plan
    is called infeasible, with the pair and the time.

    With `--world` the plan is made for the flight that `prolearn fly` flies, about an orbit with
    eccentricity, J2 and, if asked for, drag: there it meets goals and waypoints to a micrometre,
    and keeps craft apart and in their corridors, proven. The conditions are those of `fly`, or the
    scenario's own orbit. The gap is to the least fuel of linear programs about that flight.

    Examples:

        prolearn plan scenario.json --planner expert --out plan.json
        prolearn plan a.json b.json --planner refiner --out plans/
        prolearn plan a.json b.json --planner lstm2 --out plans/
        prolearn plan scenario.json --effort best --out plan.json
        prolearn plan scenario.json --assignment optimal --out plan.json
        prolearn plan s.json --risk 1e-3 --navigation-sigma 0.2 --out p.json
        prolearn plan s.json --risk 0.01 --thrust-sigma 0.01 --out p.json
        prolearn plan s.json --risk .01 --errors cold-gas --closed-loop --out p/
        prolearn plan scenario.json --passive-safety 1 --out plan.json
        prolearn plan scenario.json --world --out plan.json
        prolearn plan s.json --world --eccentricity 0.01 --out p.json
        prolearn plan a.json b.json --json --out plans/
        prolearn plan - --out p.json
    """
    from cli.jobs.planner import planner_of
    from pipeline.flight.world import in_world
    from pipeline.orbit.dynamics import model_error
    from pipeline.plan.document import write_plan
    from pipeline.plan.plan import SOLVED, summary
    from pipeline.plan.requirements import Requirements
    from pipeline.planners.as_flown import AsFlown
    from pipeline.scenario.document import read_checked
    from pipeline.scenario.part_documents import OrbitDocument

    if not world:
        why = "without --world; expected both, or neither: add --world."
        refuse(context, FlightConditions, why)
    refuse_special(out)
    targets, to_people = _targets(scenarios, out), stdout_free(out, as_json)
    for path, target in product(scenarios, targets):
        refuse_overwriting(path, target)
    for target in targets if out != STDIO else ():
        refuse_unwritable(target)
    asked = [read_checked(path, allow_drift=planning.allow_drift) for path in scenarios]
    if world:
        for path, one in zip(scenarios, asked, strict=True):
            if one.problem.orbit is not None:
                why = f"and {path} has an orbit of its own; expected one of the two: leave it out."
                refuse(context, FlightConditions, why)
        asked = [in_world(one, conditions.about(one)) for one in asked]
    requirements = Requirements(planning.separation, passive_safety, risk.limit())
    chosen = planner_of(
        planning.planner, requirements, planning.effort, raw=raw, assignment=planning.assignment
    )
    chosen = AsFlown(chosen) if world else chosen
    rows: list[dict[str, Any]] = []

    def kept() -> str:
        return f"{len(rows)} of {len(asked)} plans {'was' if len(rows) == 1 else 'were'} written."

    with explained_interrupt(kept), progress("planning") as shown, within_memory():
        shown.expect(len(asked) if len(asked) > 1 else 0)
        for group in _alike(asked):
            named = scenarios[len(rows)]
            with error_context(f"{kept()[:-1]}; {named}" if rows else named):
                plans = chosen.plan(group)
            for made in plans:
                path, target = scenarios[len(rows)], targets[len(rows)]
                write_plan(target, made)
                problem = made.scenario.problem
                error = model_error(made.states, problem.dynamics, problem.duration).total
                off = 0.0 if made.as_flown else error
                more = {"model_error": off, "collision_radius": problem.collision_radius}
                orbit = problem.orbit if made.as_flown else None
                about = orbit and OrbitDocument.of(orbit).model_dump()
                files = {"scenario": str(path), "plan": str(target)}
                rows.append({**files, **summary(made), **more, "world": about})
                shown.done()
    with stdout_for_document(not to_people):
        print_json(rows) if as_json else print_plans(rows)
    raise typer.Exit(int(any(row["status"] != SOLVED for row in rows)))


def _alike(scenarios: "list[Scenario]") -> "Iterator[list[Scenario]]":
    """Groups of consecutive scenarios that are planned together, and refused together."""

    def kind(one: "Scenario") -> tuple[object, ...]:
        return one.problem, one.n, one.unlike, one.limits is None

    for _, run in groupby(scenarios, key=kind):
        while group := list(islice(run, MOST_AT_ONCE)):
            yield group


def _targets(scenarios: list[Path], out: Path) -> list[Path]:
    if len(scenarios) == 1 and (out == STDIO or (not out.is_dir() and out.suffix)):
        return [out]
    if out == STDIO:
        raise InputError("--out is - for several scenarios; expected a folder for their plans.")
    names = [f"{stem_of(path)}.plan.json" for path in scenarios]
    # Some file systems take names for the same that differ in case, or in how accents are composed.
    if len({normalize("NFC", name.casefold()) for name in names}) < len(names):
        raise InputError(
            "two scenario files have the same name, or names that differ in case alone; expected "
            "different names."
        )
    if out.is_file():
        wanted = "a folder for several plans" if names[1:] else "a folder, or a name with .json"
        raise InputError(f"--out is the file {out}; expected {wanted}.")
    return [out / name for name in names]


@with_settings
def tradeoff(
    scenario: Annotated[Path, typer.Argument(help="Scenario file; - is standard input.")],
    settings: Tradeoff,
    as_json: AsJson = False,
) -> None:
    """Fuel against transfer time: certified plans, their lower bound, and the knee.

    Thrust arcs keep the scenario's time_step and their number varies, so each duration is a whole
    number of arcs. Into the folder go the safe plans, tradeoff.csv and a figure. The knee is
    where the curve of Δv is furthest below the line between its ends, both axes scaled to 0..1
    (Kneedle), if that distance is at least 0.1 and a minute more saves at most half as much after
    it as before; else there is none. The exit status is 1 where no duration has a safe plan.

    About an orbit that is no circle, states that do not drift depend on the time: there goals must
    be moving, unless they may drift.

    Examples:

        prolearn tradeoff scenario.json --duration 10..60min
        prolearn tradeoff scenario.json --duration 600..3600s --steps 11 --json
        prolearn tradeoff scenario.json --duration 1..3h --goal moving --out trade/
    """
    durations = seconds(settings.duration)
    from cli.jobs.planner import planner_of
    from cli.jobs.tradeoff import trade
    from pipeline.plan.requirements import Requirements

    required, assignment = Requirements(settings.separation), settings.assignment
    planner = planner_of(settings.planner, required, settings.effort, assignment=assignment)
    folder = settings.out or Path(f"{stem_of(scenario)}-tradeoff")
    stopped = explained_interrupt(lambda: "the trade-off is not complete.")
    with stopped, progress("planning") as shown, within_memory():
        rows = trade(scenario, planner, folder, settings, durations, shown)
    if as_json:
        print_json({"scenario": str(scenario), "goal": settings.goal, "points": rows})
    else:
        _print_curve(rows, folder)
    raise typer.Exit(int(all(is_unsolved(row) for row in rows)))


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
    lines = []
    for row in rows:
        bound = row["delta_v_lower_bound"]
        least = MISSING if bound is None else number(bound)
        mark = "knee" * row["knee"]
        lines.append([_minutes(row), *plan_cells(row), least, mark])
    print_rows(("transfer\nmin", *HEADINGS, "bound\nm/s", ""), lines, rows)
    for row in rows:
        if is_unsolved(row):
            echo(f"{_minutes(row)} min: {row['status']}: {row['message']}")
    bent = [row for row in rows if row["knee"]]
    for row in bent:
        note(f"The knee is at {_minutes(row)} min, where Δv is {number(row['delta_v'])} m/s.")
    if not bent:
        note(
            "There is no knee: too few plans are safe, or more time saves about as much everywhere."
        )
    echo(f"Plans, tradeoff.csv and the figure are in {folder}/.")


def _minutes(row: Mapping[str, Any]) -> str:
    return f"{row['duration'] / 60:.4g}"
