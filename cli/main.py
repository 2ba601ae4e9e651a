"""prolearn: from sampled scenarios to the report, a command a stage.

Commands import what they need when they run, so that help is instant.
"""

import os
import platform
from importlib.metadata import version
from typing import Annotated, Any

import typer

from cli import card, convert, dataset, experiments, models, plan, scenario, show, tradeoff, train, tune
from cli.app import Group

# Threads that wait for each other sleep. Where they spin, as is OpenMP's way, and another program
# wants a core too, an epoch takes some fifty times as long. Read when torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

FIRST = ("sample", "solve", "dataset")
"""Commands that the help begins with; Typer puts those that have subcommands last."""


class Line(Group):
    """All commands, in the order of the work."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names, FIRST first and the others as they were added."""
        names = super().list_commands(ctx)
        return [*FIRST, *(name for name in names if name not in FIRST)]


datasets = typer.Typer(cls=Group, subcommand_metavar="[COMMAND]", rich_markup_mode="markdown")
datasets.callback(invoke_without_command=True)(dataset.make)
datasets.command()(card.card)

app = typer.Typer(
    name="prolearn",
    cls=Line,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help="""Learned transfer planning for spacecraft swarms.

    Sample scenarios, solve them with the convex expert, train networks on its plans, compare
    them, and report. Each stage is a command; `prolearn COMMAND --help` has examples.

    Example:

        prolearn dataset --preset demo --out data/demo
    """,
    epilog="Exit status: 0 done, 1 failed, 2 bad usage or input, 130 interrupted.",
)


def _tell_version(asked: bool) -> None:
    if asked:
        where = f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"
        typer.echo(f"prolearn {version('prolearn')} ({where})")
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


app.command()(dataset.sample)
app.command()(dataset.solve)
app.command()(dataset.verify)
app.command()(train.train)
app.command()(tune.tune)
app.command()(experiments.evaluate)
app.command()(experiments.warmstart)
app.command(name="transfer-times")(experiments.transfer_times)
app.command()(experiments.ablate)
app.command()(experiments.report)
app.add_typer(scenario.app, name="scenario")
app.command()(plan.plan)
app.command()(tradeoff.tradeoff)
app.command()(convert.convert)
app.command()(show.show)
app.add_typer(datasets, name="dataset")
app.add_typer(models.app, name="models")
