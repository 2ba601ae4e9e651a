"""Options of commands: Typer's from fields of dataclasses, lists of values, completion."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from reprlib import repr as brief
from typing import TYPE_CHECKING, Annotated, Any, ParamSpec, TypeVar, get_type_hints

import typer

from pipeline.errors import InputError

if TYPE_CHECKING:
    from cli.settings import WorkerSettings
    from pipeline.parallel.workers import Workers

MOST_LISTED = 10_000  # numbers that a list on the command line may stand for
GREATEST_LISTED = 2**32 - 1  # largest number in such a list
OPTION = "option"  # in the metadata of a dataclass's field: the option that it becomes

P = ParamSpec("P")
R = TypeVar("R")


def with_settings(command: Callable[P, R]) -> Callable[..., R]:
    """Give a command an option for each field of the dataclasses among its parameters.

    Where ``command(settings: Evaluation, as_json: AsJson)`` is called, Typer sees the fields of
    ``Evaluation`` in place of ``settings``, with their annotations and defaults.
    """
    groups: dict[str, Any] = {}
    found: list[Parameter] = []
    for parameter in _parameters(command):
        is_group = is_dataclass(parameter.annotation)
        found += _parameters(parameter.annotation) if is_group else [parameter]
        if is_group:
            groups[parameter.name] = parameter.annotation

    @wraps(command)
    def run(**given: Any) -> R:
        for name, group in groups.items():
            given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
        return command(**given)  # type: ignore[call-arg]

    run.__signature__ = Signature(found)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in found}
    return run


def _parameters(called: Callable[..., Any]) -> list[Parameter]:
    """The parameters of a function or of a dataclass, by name and with their types."""
    hints = get_type_hints(called, include_extras=True)
    if is_dataclass(called):
        options = {field.name: field.metadata.get(OPTION) for field in fields(called)}
        hints |= {k: Annotated[hints[k], one] for k, one in options.items() if one is not None}
    return [
        parameter.replace(kind=Parameter.KEYWORD_ONLY, annotation=hints[name])
        for name, parameter in signature(called).parameters.items()
    ]


def given_options(context: typer.Context) -> dict[str, str]:
    """Options on the command line, as they are written there, by the name of their parameter."""
    found = {}
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if parameter.name and source is not None and source.name == "COMMANDLINE":
            found[parameter.name] = parameter.opts[0]
    return found


def refuse(context: typer.Context, names: Collection[str] | type, reason: str) -> None:
    """Raise InputError where an option is given that would have no effect.

    Such options are named, or are the fields of a dataclass; the reason says why, and what to do.
    """
    if isinstance(names, type):
        names = [field.name for field in fields(names)]
    for name, option in given_options(context).items():
        if name in names:
            raise InputError(f"{option} is given {reason}")


def int_list(text: str, option: str = "--n", least: int = 1) -> Sequence[int]:
    """Whole numbers from ``least`` on, written as 10, 2,10,30 or 2..30, ascending."""
    numbers: set[int] = set()
    try:
        for part in text.split(","):
            first, dots, last = part.partition("..")
            wanted = range(int(first), int(last if dots else first) + 1)
            if not wanted:
                raise ValueError("the range is empty")
            if len(numbers) + len(wanted) > MOST_LISTED:
                given = brief(text)
                raise InputError(f"{option} is {given}; expected at most {MOST_LISTED} numbers.")
            numbers |= set(wanted)
    except (ValueError, OverflowError):
        numbers = set()
    if not numbers or min(numbers) < least or max(numbers) > GREATEST_LISTED:
        raise InputError(
            f"{option} is {brief(text)}; expected whole numbers from {least} to {GREATEST_LISTED}, "
            "such as 10, 2,10,30 or 2..30."
        )
    return sorted(numbers)


def numbers(text: str, option: str) -> Sequence[float]:
    """Numbers written as 60 or 60,72.5,240, in this order."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError as error:
        raise InputError(
            f"{option} is {text!r}; expected numbers such as 60 or 60,72.5,240."
        ) from error


def name_list(text: str | None) -> Sequence[str]:
    """Names written as one,two,three, each once."""
    names = (name.strip() for name in (text or "").split(","))
    return [*dict.fromkeys(filter(None, names))]


def planners() -> list[str]:
    """Completion of planners: the package's, and architectures, whose champions plan."""
    from pipeline.planners.named import NAMES

    return sorted({*NAMES, *architectures("")})


def architectures(incomplete: str) -> list[str]:
    """Completion of installed architectures; of several, joined by commas, the last."""
    from pipeline.networks.recipes import architecture_names

    before, comma, _ = incomplete.rpartition(",")
    return sorted(before + comma + name for name in architecture_names())


def families() -> list[str]:
    """Completion of families of scenarios."""
    from pipeline.scenario.families import FAMILIES

    return sorted(FAMILIES)


def workers_of(context: typer.Context, settings: "WorkerSettings") -> "Workers":
    """The workers asked for; a scheduler in the environment is no error on this machine."""
    from pipeline.parallel.workers import SCHEDULER_WAIT, Workers

    if settings.backend == "loky":
        why = "and work on this machine has no scheduler; expected it with --backend dask."
        refuse(context, ("scheduler", "scheduler_wait", "shared"), why)
        return Workers(settings.jobs)
    if not settings.scheduler:
        raise InputError(
            "backend is 'dask'; expected the scheduler's address: --scheduler tcp://HOST:8786."
        )
    refuse(context, ("jobs",), "beside --backend dask, where `dask worker` decides; leave it out.")
    wait = SCHEDULER_WAIT if settings.scheduler_wait is None else settings.scheduler_wait
    return Workers(settings.jobs, settings.scheduler, wait, getattr(settings, "shared", False))
