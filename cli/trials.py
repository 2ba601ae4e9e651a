"""The options that say how a plan is flown many times, and the table of what comes of it."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cli.app import given_options
from cli.completion import planners
from cli.output import print_table
from cli.plan import Effort
from pipeline.errors import InputError
from pipeline.figures.labels import MISSING, error, number, percents, share

if TYPE_CHECKING:
    from pipeline.flight.errors import Errors
    from pipeline.flight.summary import Summary

TRIALS = "Trials with errors"
"""Group of these options in the help."""


def _option(text: str, *names: str, **more: Any) -> Any:
    return typer.Option(*names, help=text, rich_help_panel=TRIALS, **more)


Trials = Annotated[
    int | None, _option("Fly so many times, with errors that differ.", show_default=False)
]
Seed = Annotated[int, _option("Root seed of the errors.")]
Preset = Annotated[Literal["cold-gas", "none"], _option("Size of the errors, to begin with.")]
Changed = Annotated[
    list[str] | None,
    _option(
        "Change one: magnitude=0.05. Names: position, velocity, position_bias, velocity_bias, "
        "magnitude, direction, magnitude_fixed, direction_fixed, timing, missed.",
        "--error",
        metavar="NAME=VALUE",
        show_default=False,
    ),
]
WorldKind = Annotated[
    Literal["nonlinear", "linear"],
    _option("Fly in the conditions above, or in the model that plans are made for."),
]
Replan = Annotated[
    Literal["none", "every-node"],
    _option("Compare with craft that are planned anew at every node."),
]
Replanner = Annotated[
    str, _option("Who plans anew, as for `prolearn plan`.", autocompletion=planners)
]
ReplanEffort = Annotated[
    Effort | None, _option("Of the expert then, as for `prolearn plan`.", show_default=False)
]
Margin = Annotated[
    float | None,
    _option(
        "Asked for beyond r_col when planning anew, m; by default 3 sigma one interval ahead.",
        show_default=False,
    ),
]
Size = Annotated[float, _option("Distance of two craft's centres at which they may touch, m.")]
Out = Annotated[Path | None, _option("Folder; PLAN-flown by default.", show_default=False)]
Jobs = Annotated[int, _option("Processes; -1 for all cores.")]


OF_REPLANNING = ("planner", "effort", "margin")
OF_TRIALS = (
    *("seed", "errors", "error", "world", "replan", "size", "out", "jobs"),
    *OF_REPLANNING,
)
CONDITIONS = (
    *("eccentricity", "inclination", "raan", "argument_of_perigee", "argument_of_latitude"),
    *("no_j2", "drag", "drag_spread"),
)
"""Parameters that say nothing without others: a planner, trials, the nonlinear world."""


def errors_of(preset: str, changes: Sequence[str]) -> "Errors":
    """The errors of a preset with some of them changed.

    Args:
        preset: of PRESETS.
        changes: written as NAME=VALUE.

    Raises:
        InputError: for a name or a value that is none.
    """
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


def refuse(context: typer.Context, names: Collection[str], reason: str) -> None:
    """Refuse options that would have no effect.

    Args:
        context: of the command.
        names: of its parameters.
        reason: why they would have none, and what to do.

    Raises:
        InputError: naming the first that is given.
    """
    for name, option in given_options(context).items():
        if name in names:
            raise InputError(f"{option} is given {reason}")


def print_trials(summaries: "Sequence[Summary]", radius: float, size: float) -> None:
    """Print a column for each way to fly, a row for each quantity, in 80 columns for three."""
    shares = {f"within r_col, {radius:g} m": "within_radius", f"within {size:g} m": "within_size"}
    lines = [[label, *(_shared(one, name) for one in summaries)] for label, name in shares.items()]
    for label, name, text in QUANTITIES:
        values = [getattr(one, name) for one in summaries]
        if any(value is not None for value in values):
            lines.append([label, *(MISSING if v is None else text(v) for v in values)])
    print_table([f"{summaries[0].trials} trials", *(one.loop for one in summaries)], lines)


def _thousandth(text: Callable[[float], str]) -> Callable[[float], str]:
    """Written in a unit that is a thousandth of SI's."""
    return lambda value: text(1e3 * value)


QUANTITIES: Sequence[tuple[str, str, Callable[[float], str]]] = (
    ("least separation, m: median", "separation_median", number),
    ("  least of all", "least_separation", number),
    ("error at goal, m: median", "goal_error_median", error),
    ("  95 %", "goal_error_high", error),
    ("  mm/s: median", "goal_velocity_error_median", _thousandth(error)),
    ("  95 %", "goal_velocity_error_high", _thousandth(error)),
    ("Δv, m/s: median", "delta_v_median", number),
    ("  95 %", "delta_v_high", number),
    ("missed burns a trial", "missed_burns", number),
    ("margin, m", "margin", number),
    ("nodes without a safe plan", "unsafe_replans", number),
    ("time a replan, ms: median", "replan_seconds", _thousandth(number)),
)
"""Label, field of a summary, and how it is written."""


def _shared(one: "Summary", name: str) -> str:
    value, interval = getattr(one, name), getattr(one, f"{name}_interval")
    return MISSING if value is None else f"{share(value)} {percents(*interval)}"
