"""The command line of prolearn, from scenarios to the report: one command for each stage.

Commands import what they need when they run, so that help is instant.
"""

import os
import platform
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.main import get_command_name

from cli import convert, dataset, experiments, fly, models, plan, scenario, train
from cli.app import CommandGroup
from cli.output import echo
from cli.settings import option
from pipeline.files import lowest_existing
from pipeline.parallel import collect_garbage_seldom

# Threads that wait for each other sleep. Where they spin, as by OpenMP's default, and another
# program wants a core too, an epoch takes some fifty times as long. Read when torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
# To look for plugins, Pydantic would read the metadata of every installed package.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
# Typer would break descriptions at 80 columns, and fish and PowerShell take each line for a choice.
if "_PROLEARN_COMPLETE" in os.environ:
    os.environ.setdefault("TERMINAL_WIDTH", "1000")
collect_garbage_seldom()


def _no_place_for_matplotlib() -> bool:
    """Whether matplotlib cannot write in the home, as in a container, nor has another place."""
    if "MPLCONFIGDIR" in os.environ:
        return False
    try:
        config = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # there is no home
        return True
    places = lowest_existing(config), lowest_existing(cache)
    return not all(place.is_dir() and os.access(place, os.W_OK) for place in places)


if _no_place_for_matplotlib():  # it would say so, and look through all fonts each time
    from pipeline.scratch import own_folder

    with suppress(OSError):
        os.environ["MPLCONFIGDIR"] = own_folder("matplotlib")

datasets = typer.Typer(
    name="dataset", cls=CommandGroup, subcommand_metavar="[COMMAND]", rich_markup_mode="markdown"
)
datasets.callback(invoke_without_command=True)(dataset.make)
datasets.command()(dataset.card)

COMMANDS: Mapping[str, Sequence[Any]] = {
    "A swarm of your own": (
        *(scenario.app, plan.plan, fly.fly, plan.tradeoff),
        *(convert.show, convert.convert),
    ),
    "Datasets": (dataset.sample, dataset.solve, datasets, dataset.verify),
    "Networks": (train.train, train.tune, models.app),
    "Experiments": (
        *(experiments.evaluate, experiments.warmstart, experiments.transfer_times),
        *(experiments.flights, experiments.report),
    ),
}
"""Groups of commands in the help."""


class OrderedCommands(CommandGroup):
    """All commands, in the order of the work."""

    def list_commands(self, ctx: Any) -> list[str]:
        """As in COMMANDS; Typer would put those that have subcommands last."""
        return [
            str(one.info.name) if isinstance(one, typer.Typer) else get_command_name(one.__name__)
            for commands in COMMANDS.values()
            for one in commands
        ]


app = typer.Typer(
    name="prolearn",
    cls=OrderedCommands,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help="""Learned transfer planning for spacecraft swarms.

    Plan the transfer of a swarm of your own; or sample scenarios, solve them with the convex
    expert, train networks on its plans, compare them, and report. Each stage is a command;
    `prolearn COMMAND --help` has examples.

    Examples:

        prolearn plan scenario.json --out plan.json
        prolearn dataset --preset demo --out data/demo
    """,
    epilog="Exit status: 0 done, 1 failed, 2 bad usage or input, 130 Ctrl-C, 143 SIGTERM.",
)


def _tell_version(asked: bool) -> None:
    if asked:
        where = f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"
        echo(f"prolearn {version('prolearn')} ({where})")
        raise typer.Exit


@app.callback()
def _options(
    _: Annotated[
        bool,
        option("Show the version and exit.", "--version", callback=_tell_version, is_eager=True),
    ] = False,
) -> None:
    """What all commands have in common."""


for panel, commands in COMMANDS.items():
    for command in commands:
        if isinstance(command, typer.Typer):
            app.add_typer(command, rich_help_panel=panel)
        else:
            app.command(rich_help_panel=panel)(command)

if __name__ == "__main__":
    app(prog_name="prolearn")
