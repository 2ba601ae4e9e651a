"""prolearn: from sampled scenarios to the report, a command a stage.

Commands import what they need when they run, so that help is instant.
"""

import os

import typer

from cli import convert, dataset, experiments, models, plan, scenario, show, tradeoff, train, tune
from cli.app import Group

# Threads that wait for each other sleep. Where they spin, as is OpenMP's way, and another program
# wants a core too, an epoch takes some fifty times as long. Read when torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

app = typer.Typer(
    name="prolearn",
    cls=Group,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help="""Learned transfer planning for spacecraft swarms.

    Sample scenarios, solve them with the convex expert, train networks on its plans, compare
    them, and report. Each stage is a command; `prolearn COMMAND --help` has examples.

    Example:

        prolearn dataset --preset demo --out data/demo
    """,
)

app.command()(dataset.sample)
app.command()(dataset.solve)
app.command(name="dataset")(dataset.make)
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
app.add_typer(models.app, name="models")
