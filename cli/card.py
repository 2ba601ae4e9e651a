"""The command that writes the card of a dataset."""

from typing import Annotated

import typer

from cli.dataset import Folder
from cli.output import echo
from cli.progress import progress
from pipeline.urls import public_url


def card(
    folder: Folder,
    licence: Annotated[
        str, typer.Option("--license", help="Of the data, by its identifier, such as cc-by-4.0.")
    ] = "mit",
    replace: Annotated[
        bool, typer.Option("--force", help="Replace a README.md that says something else.")
    ] = False,
) -> None:
    """Write README.md into a solved dataset: its card, for readers and dataset hubs.

    Columns, splits, how it was made, how far the plans can be from optimal, limits and licence;
    at its head what `datasets.load_dataset` reads.

    Examples:

        prolearn dataset card data/paper
        prolearn dataset card data/n10 --license cc-by-4.0 --force
    """
    from pipeline.dataset.card import write_card
    from pipeline.dataset.manifest import CARD

    with progress("reading") as shown:
        write_card(folder, licence=licence, replace=replace, progress=shown)
        rows = shown.count
    where = public_url(folder)
    echo(f"{CARD} is in {where}; it tells of {rows} scenarios.")
