"""Commands about registered models: list, show, promote."""

from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from cli.app import Group

app = typer.Typer(cls=Group, no_args_is_help=True, help="Registered models: list, show, promote.")

COLUMNS = {
    "valid_position_rmse": "RMS m",
    "exp1_flown_collisions": "collisions",
    "exp1_flown_fuel": "fuel",
}
"""Metrics in the list, by name, with their headings."""


@app.command(name="list")
def list_models() -> None:
    """All versions with their aliases and main metrics."""
    from registry.models import list_versions

    table = Table(box=None, header_style="bold")
    for heading in ("model", "v", "alias", "recipe", *COLUMNS.values(), "created"):
        table.add_column(heading, no_wrap=True)
    for version in list_versions():
        numbers = [version.metrics.get(name) for name in COLUMNS]
        table.add_row(
            version.name,
            str(version.version),
            ",".join(version.aliases),
            version.recipe,
            *("" if number is None else f"{number:.3g}" for number in numbers),
            version.created.strftime("%Y-%m-%d"),
        )
    Console().print(table)


@app.command()
def show(
    model: Annotated[str, typer.Argument(help="ARCH, ARCH:RECIPE, NAME@ALIAS or NAME/VERSION.")],
) -> None:
    """One version in full: parameters, metrics, dataset, environment."""
    from registry.models import resolve

    version = resolve(model)
    table = Table(box=None, show_header=False)
    head = {
        "model": version.name,
        "version": version.version,
        "aliases": ",".join(version.aliases),
        "uri": version.uri,
        "run": version.run_id,
        "created": version.created.strftime("%Y-%m-%d %H:%M UTC"),
    }
    numbers = {name: f"{value:.6g}" for name, value in sorted(version.metrics.items())}
    for part in (head, dict(sorted(version.params.items())), numbers, version.tags):
        for name, value in part.items():
            table.add_row(name, str(value))
        table.add_section()
    Console().print(table)


@app.command()
def promote(
    name: Annotated[str, typer.Argument(help="Registered model, or its architecture.")],
    version: Annotated[int, typer.Option(help="Number of the version.", show_default=False)],
    force: Annotated[
        bool, typer.Option("--force", help="Also where it does worse than the champion.")
    ] = False,
) -> None:
    """Make a version the champion, which commands take when a model is named alone."""
    from registry.models import promote as run

    chosen = run(name, version, force=force)
    typer.echo(f"{chosen.name} version {chosen.version} is the champion.")
