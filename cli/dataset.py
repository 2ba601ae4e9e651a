"""Commands that make and check datasets: sample, solve, dataset, card, verify."""

import os
import re
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cli.options import given_options, refuse, with_settings, workers_of
from cli.output import echo, print_json, stdout_for_document
from cli.progress import progress
from cli.settings import AsJson, Family, FolderWorkers, ProblemSettings, SeparationOption, option
from pipeline.errors import InputError
from pipeline.text import as_argument, public_url

if TYPE_CHECKING:
    from pipeline.parallel.workers import Workers

AN_ORBIT = 'an object such as {"semi_major_axis": 8e6, "eccentricity": 0.1}'
Out = Annotated[str, option("Dataset folder or URL.")]
DatasetFolder = Annotated[str, typer.Argument(help="Dataset folder or URL.")]


@with_settings
def sample(
    context: typer.Context,
    out: Out,
    *,
    n: Annotated[int, option("Spacecraft in each scenario.")] = 10,
    count: Annotated[int, option("Scenarios to draw.")] = 1000,
    seed: Annotated[int, option("Root seed.")] = 0,
    family: Family = "rings",
    shares: Annotated[str, option("Shares of the train, valid and test split.")] = "0.8,0.1,0.1",
    rows_per_shard: Annotated[
        int, option("Scenarios in a file; 15 000 of n=10 take 100 MB once solved.")
    ] = 250,
    problem: ProblemSettings,
    orbit: Annotated[
        str | None,
        option("Instead of --altitude: an orbit's fields as in scenario.json.", metavar="JSON"),
    ] = None,
    workers: FolderWorkers,
) -> None:
    """Draw scenarios into a dataset folder.

    Scenario k of a split depends on seed, n, split and k alone. Several sizes may share a folder.

    Examples:

        prolearn sample --n 10 --count 10000 --seed 0 --out data/n10
        prolearn sample --orbit '{"semi_major_axis": 8e6}' --out data/e
    """
    from pipeline.dataset.making import sample as run
    from pipeline.dataset.samples import Sample
    from pipeline.documents import document_in
    from pipeline.scenario.part_documents import OrbitDocument

    _refuse_memory(out)
    try:
        train, valid, test = (float(part) for part in shares.split(","))
    except ValueError as error:
        raise InputError(
            f"--shares is {shares!r}; expected three numbers such as 0.8,0.1,0.1."
        ) from error
    one = Sample(family, seed, count, shares=(train, valid, test), shard_rows=rows_per_shard)
    asked = problem.problem()
    if orbit is not None:
        refuse(context, ("altitude",), "beside --orbit, which has a size; leave one of them out.")
        document = document_in(os.fsencode(orbit), OrbitDocument, "--orbit", AN_ORBIT)
        asked = asked.about(document.orbit())
    drawing = workers_of(context, workers)
    with progress("sampling") as shown:
        run(out, {n: one}, asked, workers=drawing.with_progress(shown))
    where = public_url(out)
    many = f"{count} scenarios of n={n} are" if count != 1 else f"1 scenario of n={n} is"
    them = "them" if count != 1 else "it"
    echo(f"{many} in {where}; solve {them}: prolearn solve {as_argument(where)}")


@with_settings
def solve(
    context: typer.Context,
    folder: DatasetFolder,
    workers: FolderWorkers,
    separation: SeparationOption = "continuous",
    solver: Annotated[
        Literal["simplex", "clarabel"],
        option("Of the convex programs: HiGHS' simplex method or Clarabel's interior points."),
    ] = "simplex",
) -> None:
    """Solve the scenarios of a folder with the expert.

    Solved shards are kept and damaged ones are made again: after an interruption of any kind run
    the same command again.

    Examples:

        prolearn solve data/n10
        prolearn solve data/n10 --jobs 8 --separation nodes
        prolearn solve s3://bucket/n10 --backend dask --scheduler tcp://HOST:8786
    """
    _solve(folder, workers_of(context, workers), separation, solver)


@with_settings
def make(
    context: typer.Context,
    *,
    preset: Annotated[Literal["demo", "paper"], option("Which dataset.")] = "paper",
    out: Annotated[str | None, option("Dataset folder or URL; data/PRESET by default.")] = None,
    workers: FolderWorkers,
) -> None:
    """Sample and solve all that the experiments need.

    The paper's: 8000 + 1000 + 1000 scenarios of n=10, and 100 test trials of each n=2..30; beyond
    the paper 50 of n=60, 50 of n=100 and 10 of n=300. A folder of an earlier version's preset gets
    what it lacks.

    Examples:

        prolearn dataset --preset demo --out data/demo
        prolearn dataset --preset paper
    """
    if context.invoked_subcommand:
        for option_ in given_options(context).values():
            raise InputError(
                f"{option_} is of `prolearn dataset` alone; expected none of its options before "
                f"{context.invoked_subcommand}."
            )
        return
    from pipeline.dataset.making import sample as run
    from pipeline.dataset.samples import PRESETS
    from pipeline.orbit.problem import Problem

    folder = out or f"data/{preset}"
    _refuse_memory(folder)
    solving = workers_of(context, workers)
    with progress("sampling") as shown:
        run(folder, PRESETS[preset], Problem(), workers=solving.with_progress(shown))
    _solve(folder, solving)


@with_settings
def card(
    context: typer.Context,
    folder: DatasetFolder,
    *,
    workers: FolderWorkers,
    licence: Annotated[
        str, option("Of the data, by its identifier, such as cc-by-4.0.", "--license")
    ] = "mit",
    replace: Annotated[
        bool, option("Replace a README.md that says something else.", "--force")
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

    reading = workers_of(context, workers)
    with progress("reading") as shown:
        write_card(folder, licence=licence, replace=replace, workers=reading.with_progress(shown))
        rows = shown.count
    where = public_url(folder)
    echo(f"{CARD} is in {where}; it describes {rows} scenarios.")


@with_settings
def verify(
    context: typer.Context,
    folder: DatasetFolder,
    *,
    workers: FolderWorkers,
    mend: Annotated[
        bool,
        option(
            "Make damaged shards again; foreign files go to _foreign/, damaged ones to _damaged/.",
            "--repair",
        ),
    ] = False,
    yes: Annotated[
        bool, option("Also set aside files with sound rows of another dataset.", "--yes")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Check the integrity of a dataset and the physics of every row.

    Dynamics, ends, separation at all times and fuel are computed anew. `--repair` deletes
    nothing, and leaves files alone whose rows are sound but not expected by the manifest: then
    it may be the manifest that is wrong. The exit status is 1 where faults are left.

    Examples:

        prolearn verify data/paper
        prolearn verify data/paper --repair
        prolearn verify data/paper --json
    """
    from pipeline.dataset.verifying import repair
    from pipeline.dataset.verifying import verify as check

    if yes and not mend:
        raise InputError("--yes is given without --repair; expected both, or neither.")
    checking = workers_of(context, workers)
    with stdout_for_document(as_json), progress("mending" if mend else "verifying") as shown:
        if mend:
            faults = repair(folder, yes=yes, workers=checking.with_progress(shown))
        else:
            faults = sorted(check(folder, workers=checking.with_progress(shown)))
    left = [fault for fault in faults if not mend or (fault.sound and not yes)]
    where, rows = public_url(folder), shown.count
    many = f"{len(faults)} fault{'s' * (len(faults) != 1)}"
    if as_json:
        counted = {} if mend else {"rows": rows}
        print_json({"folder": where, "repaired": mend, "faults": faults, **counted})
        raise typer.Exit(int(bool(left)))
    echo(*(f"{fault.path}: {fault.what}" for fault in faults), err=True)
    if not faults:
        echo(f"{where} is sound: {rows} rows.")
    elif not left:
        echo(f"{where} is mended: {many}.")
    elif not mend:
        echo(f"{many} in {where}; mend it: prolearn verify {as_argument(where)} --repair", err=True)
    else:
        echo(
            f"{many} in {where}, {len(left)} of them left: {left[0].path} holds sound rows, "
            "which the manifest does not expect. Compare the manifest with what you meant to "
            "make; to set them aside all the same: prolearn verify "
            f"{as_argument(where)} --repair --yes",
            err=True,
        )
    raise typer.Exit(int(bool(left)))


def _refuse_memory(url: str) -> None:
    """Raise InputError for a folder in the memory of the process, which ends with the command."""
    if re.match("(.*::)?memory://", url.lower()):
        raise InputError(
            f"--out is {public_url(url)}, memory that is gone when the command ends; expected a "
            "folder, or a URL that stays, such as s3://bucket/folder: give one of these."
        )


def _solve(
    folder: str,
    workers: "Workers",
    separation: Literal["continuous", "nodes"] = "continuous",
    solver: Literal["simplex", "clarabel"] = "simplex",
) -> None:
    from pipeline.dataset.making import solve as run
    from pipeline.expert import Settings
    from pipeline.plan.requirements import Requirements

    how, required = Settings(solver=solver), Requirements(separation)
    with progress("solving") as shown:
        run(folder, how, required, workers=workers.with_progress(shown))
    done = f"{shown.count} now, {shown.failed} without a plan"
    echo(f"{public_url(folder)} is solved ({done}).")
