"""The command that plans a scenario of one's own."""

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from pipeline.expert import Settings
    from pipeline.plan import Plan, Planner

from cli.dataset import SeparationName
from pipeline.errors import InputError


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
        typer.Option(help="expert, minimum-energy, straight-line, own-LP, or a model (ff1, ...)."),
    ] = "expert",
    separation: Annotated[
        SeparationName, typer.Option(help="Keep craft apart at all times, or at the nodes only.")
    ] = SeparationName.CONTINUOUS,
    effort: Annotated[
        Effort, typer.Option(help="Of the expert: the first safe plan, the default, or the best.")
    ] = Effort.DEFAULT,
    raw: Annotated[
        bool,
        typer.Option("--raw", help="A model's own plan, safe or not, without the expert after it."),
    ] = False,
    allow_drift: Annotated[
        bool, typer.Option("--allow-drift", help="Accept states that are not energy-matched.")
    ] = False,
) -> None:
    """Plan transfers of scenario files, each with a certificate.

    A model's plan seeds the expert, so that what comes out is safe; --raw leaves that out.

    Examples:

        prolearn plan scenario.json --planner expert --out plan.json
        prolearn plan a.json b.json --planner lstm2 --out plans/
    """
    from pipeline.expert import BEST, FIRST_SAFE, Settings
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
    settings = {Effort.FIRST: FIRST_SAFE, Effort.DEFAULT: Settings(), Effort.BEST: BEST}[effort]
    chosen = _planner(planner, replace(settings, separation=separation.value), raw=raw)
    failed = False
    for scenario, target in zip(asked, targets, strict=True):
        made = chosen.plan([scenario])[0]
        write_plan(target, made, scenario.problem)
        failed |= made.status != SOLVED
        typer.echo(_summary(target, made))
    raise typer.Exit(int(failed))


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


def _planner(name: str, settings: "Settings", *, raw: bool) -> "Planner":
    """The planner of a name; the expert needs neither MLflow nor torch."""
    from pipeline.expert import Expert

    if name == "expert":
        return Expert(settings)
    from registry.jobs.plan import planner_of

    return planner_of(name, raw=raw)


def _summary(target: Path, plan: "Plan") -> str:
    certificate = plan.certificate
    apart = certificate.min_separation
    closest = "" if apart is None else f", closest pair {apart:.2f} m"
    return (
        f"{target}: {plan.status}, delta-v {certificate.delta_v:.3f} m/s, "
        f"gap {certificate.optimality_gap:.2%}{closest}"
        + (f" ({plan.message})" if plan.message else "")
    )
