"""The command that trains networks."""

from enum import StrEnum
from itertools import product
from typing import TYPE_CHECKING, Annotated

import typer

from cli.app import int_list, name_list
from cli.progress import Shown, progress, say
from pipeline.errors import InputError

if TYPE_CHECKING:
    from pipeline.training.loop import Epoch
    from registry.version import ModelVersion


class RecipeName(StrEnum):
    """Recipes by name."""

    PAPER = "paper"
    TUNED = "tuned"


def train(
    arch: Annotated[
        str,
        typer.Option(
            help="ff1, ff2, ffcol, lstm1, lstm2, lstmcol, one of your own, or several: ff1,lstm2.",
            show_default=False,
        ),
    ],
    recipe: Annotated[
        RecipeName, typer.Option(help="The paper's training, or the one tuned on validation.")
    ] = RecipeName.TUNED,
    data: Annotated[str, typer.Option(help="Solved dataset, a folder or a URL.")] = "data/paper",
    n: Annotated[int, typer.Option("--n", help="Swarm size to train on.")] = 10,
    epochs: Annotated[int | None, typer.Option(help="Most epochs.")] = None,
    interior: Annotated[
        str | None,
        typer.Option(help="Input between the end states: line, zeros or minimum-energy."),
    ] = None,
    learning_rate: Annotated[float | None, typer.Option(help="Of Adam.")] = None,
    dropout: Annotated[
        float | None, typer.Option(help="Share of hidden outputs dropped in training.")
    ] = None,
    batch_size: Annotated[int | None, typer.Option(help="Instances a step.")] = None,
    collision_weight: Annotated[
        float | None, typer.Option(help="Weight of the collision penalty (ffcol, lstmcol).")
    ] = None,
    device: Annotated[str, typer.Option(help="auto, cpu, cuda or mps.")] = "auto",
    seed: Annotated[
        str, typer.Option(help="Of weights, order and dropout; several as 0,1 or 0..2.")
    ] = "0",
    memory: Annotated[
        float,
        typer.Option(help="GB that data may take; larger datasets stream shard by shard."),
    ] = 2.0,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Leave out what was trained before on the same data."),
    ] = False,
) -> None:
    """Train networks on the expert's plans and register them.

    Each run is tracked in MLflow and each model registered as prolearn-ARCH.

    Examples:

        prolearn train --arch lstm2
        prolearn train --arch ff1,ff2,ffcol --recipe paper --epochs 20
        prolearn train --arch ff1,lstm1 --seed 0..2 --resume
    """
    most = {one: _most_epochs(one, recipe, epochs) for one in name_list(arch)}
    if not most:
        raise InputError(f"--arch is {arch!r}; expected an architecture, such as lstm2.")
    from registry.jobs.train import TrainingSettings, train_model, trained_before

    seeds = int_list(seed, "--seed", least=0)
    changes = {
        "epochs": epochs,
        "interior": interior,
        "learning_rate": learning_rate,
        "dropout": dropout,
        "batch_size": batch_size,
        "collision_weight": collision_weight,
    }
    changes = {name: value for name, value in changes.items() if value is not None}
    for one, k in product(most, seeds):
        how = TrainingSettings(one, recipe, n=n, seed=k, changes=changes)
        earlier = trained_before(how, data, say) if resume else None
        if earlier is not None:
            typer.echo(f"Trained before: {_summary(earlier)}")
            continue
        title = f"training {one} ({recipe})" + (f", seed {k}" if len(seeds) > 1 else "")
        with progress(title, most[one]) as shown:

            def report(epoch: "Epoch", shown: Shown = shown) -> None:
                shown.advance(1, f"loss {epoch.valid_loss:.4g}")

            version, held = train_model(
                how, data, device=device, on_epoch=report, memory=memory * 1e9
            )
            shown.end("ended early")
        typer.echo(_summary(version))
        typer.echo(f"Champion of {version.name}: version {held.champion.version}; {held.reason}.")


def _summary(version: "ModelVersion") -> str:
    numbers = version.metrics
    return (
        f"{version.name} version {version.version} ({version.recipe}): best epoch "
        f"{numbers['best_epoch']:.0f}, predicted positions {numbers['valid_position_rmse']:.3g} m "
        f"RMS from the expert's, {numbers['training_seconds']:.0f} s."
    )


def _most_epochs(arch: str, recipe: str, epochs: int | None) -> int:
    from pipeline.training.recipes import recipe_for

    return epochs or recipe_for(arch, recipe).epochs
