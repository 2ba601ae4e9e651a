"""The command that searches for better hyperparameters."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.completion import architectures
from cli.output import AsJson, beside, echo, print_json
from cli.progress import progress
from pipeline.urls import public_url

if TYPE_CHECKING:
    from cli.stages.tune import Tuned


def tune(
    arch: Annotated[
        str,
        typer.Option(
            help="Architecture, such as lstm2.", show_default=False, autocompletion=architectures
        ),
    ],
    trials: Annotated[int, typer.Option(help="Trials in all, earlier ones included.")] = 20,
    recipe: Annotated[str, typer.Option(help="Recipe that the trials start from.")] = "tuned",
    data: Annotated[str, typer.Option(help="Solved dataset, a folder or a URL.")] = "data/paper",
    n: Annotated[int, typer.Option("--n", help="Swarm size to train on.")] = 10,
    epochs: Annotated[int | None, typer.Option(help="Most epochs of a trial.")] = None,
    device: Annotated[str, typer.Option(help="auto, cpu, cuda or mps.")] = "auto",
    seed: Annotated[int, typer.Option(help="Of the search and of each training.")] = 0,
    storage: Annotated[
        Path | None,
        typer.Option(help="Optuna's SQLite file; optuna.db beside mlflow.db by default."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Search learning rate, batch size, dropout and input with Optuna.

    What counts is the distance from the expert's positions on the validation split, or what an
    architecture of your own names instead. Each trial is a nested MLflow run. After an
    interruption run the same command again: it goes on to the same number of trials. Several
    processes may share the work.

    Examples:

        prolearn tune --arch lstm2 --trials 20
        prolearn tune --arch ff1 --trials 50 --epochs 20 --data data/demo
    """
    from cli.stages.tune import tune as run

    with beside(as_json), progress(f"tuning {arch}") as shown:
        found = run(
            arch,
            recipe,
            data,
            trials=trials,
            n=n,
            seed=seed,
            device=device,
            epochs=epochs,
            storage=storage,
            progress=shown,
        )
    if as_json:
        print_json(found)
        return
    echo(*_summary(found, arch, recipe, data, n))


def _summary(found: "Tuned", arch: str, recipe: str, data: str, n: int) -> tuple[str, str]:
    options = " ".join(
        f"--{name.replace('_', '-')} {value:.4g}"
        if isinstance(value, float)
        else f"--{name.replace('_', '-')} {value}"
        for name, value in found.best.items()
    )
    return (
        f"{found.trials} trials are complete in {found.storage}; best {found.told} on validation "
        f"data; MLflow run {found.run_id}.",
        f"Train with its settings: prolearn train --arch {arch} --recipe {recipe} --data "
        f"{public_url(data)} --n {n} {options}",
    )
