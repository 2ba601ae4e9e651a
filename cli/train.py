"""The command that trains networks."""

from itertools import product
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.app import int_list, name_list
from cli.completion import architectures
from cli.models import told
from cli.output import AsJson, beside, echo, print_json
from cli.progress import progress
from pipeline.errors import InputError

if TYPE_CHECKING:
    from cli.stages.train import TrainingSettings
    from registry.version import ModelVersion


def train(
    arch: Annotated[
        str,
        typer.Option(
            help="ff1, ff2, ffcol, lstm1, lstm2, lstmcol, refiner, one of your own, or "
            "several: ff1,lstm2.",
            show_default=False,
            autocompletion=architectures,
        ),
    ],
    recipe: Annotated[
        str,
        typer.Option(help="paper, tuned (on validation), or one of the architecture's own."),
    ] = "tuned",
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
    crowded: Annotated[
        int | None,
        typer.Option(help="Crowded scenarios that the refiner learns from beside the dataset's."),
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
    as_json: AsJson = False,
) -> None:
    """Train networks and register them: on the expert's plans, the refiner on scenarios alone.

    Each run is tracked in MLflow and each model registered as prolearn-ARCH.

    Examples:

        prolearn train --arch lstm2
        prolearn train --arch ff1,ff2,ffcol --recipe paper --epochs 20
        prolearn train --arch ff1,lstm1 --seed 0..2 --resume
    """
    names = name_list(arch)
    if not names:
        raise InputError(f"--arch is {arch!r}; expected an architecture, such as lstm2.")
    from cli.stages.train import TrainingSettings

    seeds = int_list(seed, "--seed", least=0)
    changes = {
        "epochs": epochs,
        "interior": interior,
        "learning_rate": learning_rate,
        "dropout": dropout,
        "batch_size": batch_size,
        "collision_weight": collision_weight,
        "crowded": crowded,
    }
    changes = {name: value for name, value in changes.items() if value is not None}
    asked = [
        TrainingSettings(one, recipe, n=n, seed=k, changes=changes)
        for one, k in product(names, seeds)
    ]
    for how in asked:
        how.followed  # noqa: B018  (a name that is wrong stops all of them)
    options: Any = {"resume": resume, "device": device, "memory": memory * 1e9}
    several = len(seeds) > 1
    with beside(as_json):
        documents = [_trained(how, data, several=several, **options) for how in asked]
    if as_json:
        print_json(documents)


def _trained(
    how: "TrainingSettings", data: str, *, several: bool, resume: bool, device: str, memory: float
) -> dict[str, Any]:
    """Train a network, or find it trained before; say so, and tell what programs are told."""
    from cli.stages.train import train_model, trained_before

    title = f"training {how.arch} ({how.recipe})" + (f", seed {how.seed}" if several else "")
    with progress(title) as shown:
        earlier = trained_before(how, data, device, shown) if resume else None
        version, held = earlier or train_model(
            how, data, device=device, memory=memory, progress=shown
        )
    echo(f"Trained before: {_summary(version)}" if earlier else _summary(version))
    document = {**told(version), "earlier": earlier is not None}
    if held is None:
        return document
    champion = held.champion and held.champion.version
    who = f"version {champion}" if champion else "none"
    echo(f"Champion of {version.name}: {who}; {held.reason}.")
    return {**document, "champion": champion}


def _summary(version: "ModelVersion") -> str:
    names = ("best_epoch", "valid_position_rmse", "training_seconds")
    epoch, rmse, seconds = (version.metrics.get(name, float("nan")) for name in names)
    return (
        f"{version.name} version {version.version} ({version.recipe}): best epoch {epoch:.0f}, "
        f"predicted positions {rmse:.3g} m RMS from the expert's, {seconds:.0f} s."
    )
