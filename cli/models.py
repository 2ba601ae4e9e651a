"""Commands about registered models: list, show, promote, export, register."""

from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.table import Column, Table

from cli.app import CommandGroup
from cli.output import echo, plain_text, print_json, print_table, stdout_for_document, wide_console
from cli.progress import progress
from cli.settings import AsJson, option
from pipeline.errors import InputError

if TYPE_CHECKING:
    from pipeline.networks.onnx_export import Exported
    from pipeline.networks.refiner.on_board_export import ExportedCraft
    from registry.models import ModelVersion

app = typer.Typer(
    name="models",
    cls=CommandGroup,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    help="""Registered models: list them, show, promote, export or register one.

    Wherever a model is asked for, an architecture alone means its champion.

    Examples:

        prolearn models list
        prolearn models show lstm2
    """,
)


ModelArgument = Annotated[
    str, typer.Argument(help="ARCH, ARCH:RECIPE, NAME@ALIAS, NAME/VERSION or a models:/ URI.")
]

# Metrics in the list, by name, with their headings
COLUMNS = {
    "valid_position_rmse": "valid.\nRMS m",
    "exp1_flown_collisions": "colli-\nsions",
    "exp1_flown_fuel": "fuel\nm/s²",
}
BY_SIZE = "exp2_"  # metrics with a value for each n, of which MLflow gives that of the last alone
AGES = ((86400, "d"), (3600, "h"), (60, "min"))  # units of an age, s


@app.command(name="list")
def list_models(as_json: AsJson = False) -> None:
    """All versions: alias, validation error, collisions and fuel when flown, dataset, age.

    Collisions and fuel are there once `prolearn evaluate` has measured them.

    Examples:

        prolearn models list
        prolearn models list --json
    """
    from registry.models import list_versions

    with stdout_for_document(as_json):
        versions = list_versions()
    if as_json:
        print_json([document_of(version) for version in versions])
        return
    headings = ("model", "v.", "alias", "recipe", *COLUMNS.values(), "dataset", "age")
    print_table(headings, [_cells(version) for version in versions], texts=(0, 2, 3, 7))


def document_of(version: "ModelVersion") -> dict[str, Any]:
    """A version as a JSON document has it."""
    return {"uri": version.uri, **vars(version)}


def _cells(version: "ModelVersion") -> list[str]:
    numbers = [version.metrics.get(name) for name in COLUMNS]
    folder = Path(version.params.get("dataset", "")).name
    return [
        version.name,
        str(version.version),
        ",".join(version.aliases),
        version.recipe,
        *("" if number is None else f"{number:.3g}" for number in numbers),
        f"{folder[:7]} {version.dataset_digest[:6]}".strip(),
        _age(version.created),
    ]


def _age(created: datetime) -> str:
    seconds = (datetime.now(UTC) - created).total_seconds()
    ages = (f"{seconds // length:.0f} {unit}" for length, unit in AGES if seconds >= length)
    return next(ages, "new")


@app.command()
def show(model: ModelArgument, as_json: AsJson = False) -> None:
    """One version in full: parameters, metrics, dataset, environment.

    An architecture alone means its champion. Metrics by swarm size are in the report and the UI.

    Examples:

        prolearn models show lstm2
        prolearn models show lstm2:paper
        prolearn models show prolearn-lstm2/3
    """
    from registry.models import resolve

    with stdout_for_document(as_json):
        version = resolve(model)
    if as_json:
        print_json(document_of(version))
        return
    table = Table(Column(overflow="fold"), Column(overflow="fold"), box=None, show_header=False)
    head = {
        **{"model": version.name, "version": version.version, "uri": version.uri},
        **{"aliases": ",".join(version.aliases), "run": version.run_id},
        "created": version.created.strftime("%Y-%m-%d %H:%M UTC"),
    }
    given = sorted(version.metrics.items())
    numbers = {name: f"{value:.6g}" for name, value in given if not name.startswith(BY_SIZE)}
    for part in (head, dict(sorted(version.params.items())), numbers, version.tags):
        for name, value in part.items():
            table.add_row(plain_text(name), plain_text(value))
        table.add_section()
    wide_console().print(table)


@app.command()
def promote(
    name: Annotated[str, typer.Argument(help="Registered model, or its architecture.")],
    version: Annotated[int, option("Number of the version.")],
    data: Annotated[
        str | None,
        option("Dataset whose validation split decides; by default what it was trained on."),
    ] = None,
    force: Annotated[
        bool, option("Also where it does no better than the champion.", "--force")
    ] = False,
) -> None:
    """Make a version the champion, which commands take when a model is named alone.

    Both fly the same validation scenarios: the safer one is better, or, where the difference may
    be chance, the cheaper one. `prolearn train` does so with each version that it registers.

    Example:

        prolearn models promote lstm2 --version 3 --data data/paper
    """
    from cli.jobs.train import promote as run

    if force and data is not None:
        raise InputError(
            "--data is given with --force, which compares nothing; expected one of the two."
        )
    champion, why = run(name, version, data, force=force)
    reason = f" ({why})" if why else ""
    echo(f"{champion.name} version {champion.version} is the champion{reason}.")


@app.command()
def export(
    models: Annotated[
        list[str],
        typer.Argument(
            help="ARCH, ARCH:RECIPE, NAME@ALIAS, NAME/VERSION or a models:/ URI; one or several. "
            "packaged: the refiner that comes with prolearn."
        ),
    ],
    out: Annotated[
        Path | None,
        option("The file, or a folder for several models; NAME-vVERSION.onnx by default."),
    ] = None,
    file_format: Annotated[Literal["onnx"], option("Format.", "--format")] = "onnx",
    n: Annotated[
        int | None,
        option(
            "Spacecraft that the file is for; by default any number that one graph answers for. "
            "Feed-forward networks beyond their training's size need it."
        ),
    ] = None,
    flown: Annotated[
        bool, option("Project onto transfers that can be flown; adds controls.", "--flown")
    ] = False,
) -> None:
    """Write models for on-board use, each as one file with a model card beside it.

    States in m and m/s go in and come out; scaling is inside. onnxruntime's answer is compared
    with torch's before the file takes its name. A refiner becomes a folder with the part that one
    craft runs: a file for each step, between which craft exchange messages. The refiner that
    `prolearn plan --planner refiner` runs is called packaged here, and needs no store.

    Examples:

        prolearn models export lstm2 --format onnx
        prolearn models export ff1/3 --n 12 --flown --out ff1-n12.onnx
        prolearn models export ff1 lstm2 --out onboard/
        prolearn models export packaged --out refiner/
    """
    import onnx  # noqa: F401  (first: its extra has all else that is needed here)

    from cli.jobs.export import PACKAGED, refuse_options
    from cli.jobs.export import export as run
    from registry.models import resolve

    # A wrong name, or an option that one of them does not take, stops all.
    versions = [None if model == PACKAGED else resolve(model) for model in models]
    for version in versions:
        refuse_options(version, n, flown=flown)
    targets = _targets(versions, out)
    with progress("exporting") as shown:
        shown.expect(len(models) if len(models) > 1 else 0)
        for version, target in zip(versions, targets, strict=True):
            file, card = run(version, target, n=n, flown=flown)
            _print_export(file)
            echo(f"Model card: {card}")
            shown.done()


def _targets(versions: Sequence["ModelVersion | None"], out: Path | None) -> list[Path | None]:
    from cli.jobs.export import file_name

    if len(versions) == 1:
        return [out]
    names = [file_name(version) for version in versions]
    name, count = Counter(names).most_common(1)[0]
    if count > 1:
        raise InputError(f"{name} is asked for {count} times; expected different models.")
    if out is not None and out.is_file():
        raise InputError(f"--out is the file {out}; expected a folder for several models.")
    return [(out or Path()) / name for name in names]


def _print_export(file: "Exported | ExportedCraft") -> None:
    from pipeline.networks.refiner.on_board_export import ExportedCraft

    if isinstance(file, ExportedCraft):
        steps = ", ".join(f"{name} {kib:.0f} KiB" for name, kib in file.kib.items())
        times = ", ".join(f"{s * 1e3:.2g} ms ({name})" for name, s in file.seconds.items())
        echo(
            f"{file.folder}/: one craft's steps: {steps}.",
            f"onnxruntime on one core, one call: {times}.",
            f"Messages of a round for each live encounter: {sum(file.told.values())} numbers.",
            f"Largest difference from torch in {file.swarms} swarms flown craft by craft: "
            f"{file.difference:.1e} of the largest control.",
        )
    else:
        times = ", ".join(f"{s * 1e3:.3g} ms (n={n})" for n, s in file.seconds.items())
        echo(
            f"{file.path}: {file.kib:.0f} KiB, for {file.sizes}.",
            f"onnxruntime on one core, one instance: {times}.",
            f"Largest difference from torch: {file.difference:.1e} of a component's size, "
            f"{file.metres:.1e} m in position.",
        )


@app.command()
def register(folder: Annotated[Path, typer.Argument(help="A folder in unregistered/.")]) -> None:
    """Register a trained network that was kept because the tracking store had failed.

    The folder stays as it is.

    Example:

        prolearn models register unregistered/lstm2-20260101T120000.000000Z
    """
    from registry.training import register_kept

    version = register_kept(folder)
    echo(f"{version.name} version {version.version} is registered; {folder} can be deleted.")
