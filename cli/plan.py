"""The command that plans a scenario of one's own."""

from collections.abc import Iterator
from enum import StrEnum
from itertools import groupby, islice
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from pipeline.plan import Plan
    from pipeline.planners.planner import Planner
    from pipeline.scenario import Scenario

from cli.dataset import Separation
from cli.progress import progress
from pipeline.errors import InputError

TOGETHER = 50
"""Most scenarios that are planned at once, so that progress is seen and what is done is kept."""


class Effort(StrEnum):
    """How long the expert looks for a better plan."""

    FIRST = "first"
    DEFAULT = "default"
    BEST = "best"


def plan(
    scenarios: Annotated[list[Path], typer.Argument(help="Scenario files.", show_default=False)],
    out: Annotated[
        Path, typer.Option(help="Plan file, or a folder for several.", show_default=False)
    ],
    planner: Annotated[
        str,
        typer.Option(
            help="expert, refiner, minimum-energy, straight-line, own-LP, or a model (ff1, ...)."
        ),
    ] = "expert",
    separation: Separation = "continuous",
    effort: Annotated[
        Effort | None,
        typer.Option(
            help="Of the expert: stop at the first safe plan, as soon as it no longer improves, or "
            "at the best of several searches. By default the second; after a model, the first.",
            show_default=False,
        ),
    ] = None,
    raw: Annotated[
        bool,
        typer.Option("--raw", help="A model's own plan, safe or not, without the expert after it."),
    ] = False,
    allow_drift: Annotated[
        bool, typer.Option("--allow-drift", help="Accept states that are not energy-matched.")
    ] = False,
) -> None:
    """Plan transfers of scenario files, each with a certificate.

    The refiner's plan is taken where it is proven safe, else one convex solve follows it, else
    the expert plans; the plan says which. The plan of any other model seeds the expert. So what
    comes out is safe; --raw leaves the expert out. The refiner and LSTMs plan on time grids other
    than that of their training, too. `refiner` comes with the package; one that was trained here
    is named with its recipe or version, as refiner:tuned.

    Examples:

        prolearn plan scenario.json --planner expert --out plan.json
        prolearn plan a.json b.json --planner refiner --out plans/
        prolearn plan a.json b.json --planner lstm2 --out plans/
        prolearn plan scenario.json --effort best --out plan.json
    """
    from pipeline.plan import SOLVED
    from pipeline.plan.document import write_plan
    from pipeline.scenario import check
    from pipeline.scenario.document import read_scenario

    targets = _targets(scenarios, out)
    asked = [read_scenario(path) for path in scenarios]
    for path, scenario in zip(scenarios, asked, strict=True):
        try:
            check(scenario, allow_drift=allow_drift)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
    chosen = _planner(planner, separation, effort, raw=raw)
    failed, left = False, iter(targets)
    with progress("planning") as shown:
        shown.expect(len(asked) if len(asked) > 1 else 0)
        for group in _alike(asked):
            for scenario, made in zip(group, chosen.plan(group), strict=True):
                target = next(left)
                write_plan(target, made, scenario)
                failed |= made.status != SOLVED
                typer.echo(_summary(target, made))
                shown.done()
    raise typer.Exit(int(failed))


def _alike(scenarios: "list[Scenario]") -> "Iterator[list[Scenario]]":
    """Neighbours of one problem and size, which are planned together."""
    for _, run in groupby(scenarios, key=lambda scenario: (scenario.problem, scenario.n)):
        while group := list(islice(run, TOGETHER)):
            yield group


def _targets(scenarios: list[Path], out: Path) -> list[Path]:
    """Where each plan goes."""
    if len(scenarios) == 1 and not out.is_dir() and out.suffix:
        return [out]
    names = [f"{path.stem}.plan.json" for path in scenarios]
    if len(set(names)) < len(names):
        raise InputError("two scenario files have the same name; expected different names.")
    if out.is_file():
        raise InputError(f"--out is the file {out}; expected a folder for several plans.")
    return [out / name for name in names]


def _planner(name: str, separation: Separation, effort: Effort | None, *, raw: bool) -> "Planner":
    """The planner of a name; all but models need neither MLflow nor torch."""
    from pipeline.planners.named import named_planner

    told: Any = {"separation": separation, "effort": effort and effort.value, "raw": raw}
    found = named_planner(name, **told)
    if found is None:
        from cli.stages.plan import model_planner

        found = model_planner(name, **told)
    return found


def _summary(target: Path, plan: "Plan") -> str:
    """Who made the plan, what it costs, how far from optimal it can be, who comes closest when."""
    from pipeline.plan import INFEASIBLE

    certificate = plan.certificate
    parts = [f"{plan.status} by {plan.planner}", f"delta-v {certificate.delta_v:.3f} m/s"]
    # Where no plan keeps to the thrust limit, no optimum is there to be far from.
    if plan.status != INFEASIBLE and isfinite(certificate.optimality_gap):
        parts.append(f"gap {certificate.optimality_gap:.2%}")
    if certificate.min_separation_pair is not None:
        i, j = certificate.min_separation_pair
        parts.append(
            f"closest craft {i} and {j}, {certificate.min_separation:.2f} m at "
            f"{certificate.min_separation_time:.0f} s"
        )
    return f"{target}: {', '.join(parts)}" + (f" ({plan.message})" if plan.message else "")
