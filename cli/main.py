"""prolearn: from sampled scenarios to the report, a command a stage.

Commands import what they need when they run, so that help is instant.
"""

import os
import platform
from importlib.metadata import version
from typing import Annotated, Any

import typer

from cli import convert, dataset, experiments, fly, models, plan, scenario, tradeoff, train
from cli.app import Group
from cli.output import echo

# Threads that wait for each other sleep. Where they spin, as is OpenMP's way, and another program
# wants a core too, an epoch takes some fifty times as long. Read when torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

SWARM, DATASETS, NETWORKS, EXPERIMENTS = (
    "A swarm of your own",
    "Datasets",
    "Networks",
    "Experiments",
)
"""Groups of commands in the help."""

ORDER = (
    *("scenario", "plan", "fly", "tradeoff", "show", "convert"),
    *("sample", "solve", "dataset", "verify"),
    *("train", "tune", "models"),
    *("evaluate", "warmstart", "transfer-times", "flights", "report"),
)
"""Commands as the help has them; Typer would put those that have subcommands last."""


class Line(Group):
    """All commands, in the order of the work."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names in ORDER."""
        return sorted(super().list_commands(ctx), key=ORDER.index)


datasets = typer.Typer(cls=Group, subcommand_metavar="[COMMAND]", rich_markup_mode="markdown")
datasets.callback(invoke_without_command=True)(dataset.make)
datasets.command()(dataset.card)

app = typer.Typer(
    name="prolearn",
    cls=Line,
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
        typer.Option(
            "--version", help="Show the version and exit.", callback=_tell_version, is_eager=True
        ),
    ] = False,
) -> None:
    """What all commands have in common."""


app.add_typer(scenario.app, name="scenario", rich_help_panel=SWARM)
app.command(rich_help_panel=SWARM)(plan.plan)
app.command(rich_help_panel=SWARM)(fly.fly)
app.command(rich_help_panel=SWARM)(tradeoff.tradeoff)
app.command(rich_help_panel=SWARM)(convert.show)
app.command(rich_help_panel=SWARM)(convert.convert)
app.command(rich_help_panel=DATASETS)(dataset.sample)
app.command(rich_help_panel=DATASETS)(dataset.solve)
app.add_typer(datasets, name="dataset", rich_help_panel=DATASETS)
app.command(rich_help_panel=DATASETS)(dataset.verify)
app.command(rich_help_panel=NETWORKS)(train.train)
app.command(rich_help_panel=NETWORKS)(train.tune)
app.add_typer(models.app, name="models", rich_help_panel=NETWORKS)
app.command(rich_help_panel=EXPERIMENTS)(experiments.evaluate)
app.command(rich_help_panel=EXPERIMENTS)(experiments.warmstart)
app.command(name="transfer-times", rich_help_panel=EXPERIMENTS)(experiments.transfer_times)
app.command(rich_help_panel=EXPERIMENTS)(experiments.flights)
app.command(rich_help_panel=EXPERIMENTS)(experiments.report)
