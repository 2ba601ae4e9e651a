"""Commands that train networks and search for hyperparameters."""

from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.models import document_of
from cli.options import architectures, int_list, name_list, with_settings, workers_of
from cli.output import echo, print_json, print_result, stdout_for_document
from cli.progress import progress
from cli.settings import AsJson, TrainingSettings, TrainingWorkers, TuningSettings, option
from pipeline.errors import InputError
from pipeline.text import as_argument, public_url

if TYPE_CHECKING:
    from cli.jobs.train import Contest
    from pipeline.parallel.workers import Workers
    from registry.models import ModelVersion


@with_settings
def train(
    context: typer.Context,
    arch: Annotated[
        str,
        option(
            "ff1, ff2, ffcol, lstm1, lstm2, lstmcol, refiner, one of your own, or several: "
            "ff1,lstm2.",
            autocompletion=architectures,
        ),
    ],
    settings: TrainingSettings,
    workers: TrainingWorkers,
    seed: Annotated[str, option("Of weights, order and dropout; several as 0,1 or 0..2.")] = "0",
    resume: Annotated[
        bool, option("Leave out what was trained before on the same data.", "--resume")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Train networks and register them: on the expert's plans, the refiner on scenarios alone.

    Each run is tracked in MLflow and each model registered as prolearn-ARCH. Several train one
    after the other, or at once with --jobs or on a Dask cluster whose machines all reach --data.

    Examples:

        prolearn train --arch lstm2
        prolearn train --arch ff1,ff2,ffcol --recipe paper --epochs 20
        prolearn train --arch ff1,lstm1 --seed 0..2 --jobs 2 --resume
    """
    names = name_list(arch)
    if not names:
        raise InputError(f"--arch is {arch!r}; expected an architecture, such as lstm2.")
    from cli.jobs.training import recipe_of

    asked = list(product(names, int_list(seed, "--seed", least=0)))
    for one, number in asked:
        recipe_of(one, number, settings)  # a name that is wrong stops all of them
    by = workers_of(context, workers)
    at_once = by.scheduler is not None or (by.jobs != 1 and len(asked) > 1)
    several = len({number for _, number in asked}) > 1
    with stdout_for_document(as_json):
        if at_once:
            documents = _trained_at_once(asked, settings, by, resume=resume)
        else:
            documents = [
                _trained(one, number, settings, several=several, resume=resume)
                for one, number in asked
            ]
    if as_json:
        print_json(documents)


def _trained(
    arch: str, seed: int, settings: TrainingSettings, *, several: bool, resume: bool
) -> dict[str, Any]:
    from cli.jobs.train import train_model, trained_before

    title = f"training {arch} ({settings.recipe})" + (f", seed {seed}" if several else "")
    with progress(title) as shown:
        earlier = trained_before(arch, seed, settings, shown) if resume else None
        found = earlier or train_model(arch, seed, settings, shown)
    return _told(*found, earlier=earlier is not None)


def _trained_at_once(
    asked: Sequence[tuple[str, int]],
    settings: TrainingSettings,
    workers: "Workers",
    *,
    resume: bool,
) -> list[dict[str, Any]]:
    from cli.jobs.train import train_models, trained_before
    from cli.jobs.training import TrainingTask

    with progress(f"training ({settings.recipe})") as shown:
        earlier = [trained_before(*one, settings, shown) if resume else None for one in asked]
        left = [
            TrainingTask.of(*one, settings)
            for one, before in zip(asked, earlier, strict=True)
            if before is None
        ]
        made = iter(train_models(left, workers.with_progress(shown)))
    return [_told(*(one or next(made)), earlier=one is not None) for one in earlier]


def _told(version: "ModelVersion", contest: "Contest | None", *, earlier: bool) -> dict[str, Any]:
    names = ("best_epoch", "valid_position_rmse", "training_seconds")
    epoch, rmse, seconds = (version.metrics.get(name, float("nan")) for name in names)
    echo(
        f"{'Trained before: ' if earlier else ''}{version.name} version {version.version} "
        f"({version.recipe}): best epoch {epoch:.0f}, predicted positions {rmse:.3g} m RMS from "
        f"the expert's, {seconds:.0f} s."
    )
    if contest is None:
        return {**document_of(version), "earlier": earlier}
    champion = contest.champion.version
    echo(f"Champion of {version.name}: version {champion}; {contest.reason}.")
    return {**document_of(contest.version), "earlier": earlier, "champion": champion}


@with_settings
def tune(
    context: typer.Context,
    settings: TuningSettings,
    workers: TrainingWorkers,
    as_json: AsJson = False,
) -> None:
    """Search learning rate, batch size, dropout and input with Optuna.

    It minimizes the distance from the expert's positions on the validation split, or the metric
    that the architecture names: the refiner, its validation loss. Each trial is a nested MLflow
    run. After an interruption run the same command again: it goes on to the same number of trials.
    Trials are the same one after the other, with --jobs, or on a Dask cluster whose machines all
    reach --data. Several processes may share the work.

    Examples:

        prolearn tune --arch lstm2 --trials 20
        prolearn tune --arch ff1 --trials 50 --epochs 20 --at-once 5 --jobs 5
    """
    from cli.jobs.tune import tune as job

    by = workers_of(context, workers)
    with stdout_for_document(as_json), progress(f"tuning {settings.arch}") as shown:
        found = job(settings, workers=by.with_progress(shown))
    given = {"epochs": settings.epochs, "seed": settings.seed, **found.best}
    values = {k: f"{v:.4g}" if isinstance(v, float) else v for k, v in given.items()}
    known = {k.replace("_", "-"): value for k, value in values.items() if value is not None}
    options = " ".join(f"--{name} {value}" for name, value in known.items())
    print_result(
        as_json,
        found,
        f"Complete trials: {found.trials}, in {found.storage}; best {found.in_words} on "
        f"validation data; MLflow run {found.run_id}.",
        f"Train with its settings: prolearn train --arch {settings.arch} --recipe "
        f"{settings.recipe} --data {as_argument(public_url(settings.data))} --n {settings.n} "
        f"{options}",
    )
