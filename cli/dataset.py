"""Commands that make and check datasets: sample, solve, dataset, verify."""

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cli.app import given_options
from cli.completion import families
from cli.output import AsJson, beside, echo, print_json
from cli.problem import (
    Altitude,
    CollisionRadius,
    MaxAcceleration,
    Nodes,
    TimeStep,
    problem_at,
)
from cli.progress import progress
from pipeline.errors import InputError
from pipeline.urls import public_url

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pipeline.dataset.verifying import Fault
    from pipeline.expert import Settings
    from pipeline.parallel.workers import Workers
    from pipeline.plan import Requirements


Jobs = Annotated[int, typer.Option(help="Processes; -1 for all cores.")]
Out = Annotated[str, typer.Option(help="Dataset folder or URL.", show_default=False)]
Folder = Annotated[str, typer.Argument(help="Dataset folder or URL.", show_default=False)]
Backend = Annotated[
    Literal["loky", "dask"],
    typer.Option(help="Where workers run: this machine, or a Dask cluster."),
]
Separation = Annotated[
    Literal["continuous", "nodes"],
    typer.Option(help="Keep craft apart at all times, or at the nodes only."),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        help="Of the Dask cluster, such as tcp://10.0.0.1:8786.",
        envvar="DASK_SCHEDULER_ADDRESS",
        show_envvar=True,
    ),
]

SchedulerWait = Annotated[
    float | None,
    typer.Option(
        help="Seconds in which a scheduler that was lost may come back; 300 by default.",
        show_default=False,
    ),
]


def sample(
    out: Out,
    n: Annotated[int, typer.Option("--n", help="Spacecraft in each scenario.")] = 10,
    count: Annotated[int, typer.Option(help="Scenarios to draw.")] = 1000,
    seed: Annotated[int, typer.Option(help="Root seed.")] = 0,
    family: Annotated[
        str,
        typer.Option(
            help="rings, dense, coplanar-split, tilt-split, independent or rotation.",
            autocompletion=families,
        ),
    ] = "rings",
    shares: Annotated[
        str, typer.Option(help="Shares of the train, valid and test split.")
    ] = "0.8,0.1,0.1",
    altitude: Altitude = 500e3,
    time_step: TimeStep = 120.0,
    nodes: Nodes = 11,
    collision_radius: CollisionRadius = 15.0,
    max_acceleration: MaxAcceleration = None,
    jobs: Jobs = -1,
) -> None:
    """Draw scenarios into a dataset folder.

    Scenario k of a split depends on seed, n, split and k alone. Several sizes may share a folder.

    Example:

        prolearn sample --n 10 --count 10000 --seed 0 --out data/n10
    """
    from pipeline.dataset.samples import Sample
    from pipeline.dataset.sampling import sample as run

    problem = problem_at(altitude, time_step, nodes, collision_radius, max_acceleration)
    one = Sample(family=family, seed=seed, count=count, shares=_shares(shares))
    with progress("sampling") as shown:
        run(out, {n: one}, problem, jobs=jobs, progress=shown)
    where = public_url(out)
    echo(f"{count} scenarios of n={n} are in {where}; solve them: prolearn solve {where}")


def solve(
    context: typer.Context,
    folder: Folder,
    jobs: Jobs = -1,
    backend: Backend = "loky",
    scheduler: Scheduler = None,
    scheduler_wait: SchedulerWait = None,
    separation: Separation = "continuous",
    solver: Annotated[
        Literal["simplex", "clarabel"],
        typer.Option(
            help="Of the convex programs: HiGHS' simplex method or Clarabel's interior points."
        ),
    ] = "simplex",
) -> None:
    """Solve the scenarios of a folder with the expert.

    What is solved already is kept and what is damaged is done again: after an interruption of
    any kind run the same command again.

    Examples:

        prolearn solve data/n10
        prolearn solve data/n10 --jobs 8 --separation nodes
        prolearn solve s3://bucket/n10 --backend dask --scheduler tcp://HOST:8786
    """
    from pipeline.expert import Settings
    from pipeline.plan import Requirements

    workers = _workers(context, jobs, backend, scheduler, scheduler_wait)
    _solve(folder, Settings(solver=solver), Requirements(separation), workers)


def make(
    context: typer.Context,
    preset: Annotated[Literal["demo", "paper"], typer.Option(help="Which dataset.")] = "paper",
    out: Annotated[
        str | None, typer.Option(help="Dataset folder or URL; data/PRESET by default.")
    ] = None,
    jobs: Jobs = -1,
    backend: Backend = "loky",
    scheduler: Scheduler = None,
    scheduler_wait: SchedulerWait = None,
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
        _refuse_options(context)
        return
    from pipeline.dataset.samples import PRESETS
    from pipeline.dataset.sampling import sample as run
    from pipeline.expert import Settings
    from pipeline.orbit.problem import Problem
    from pipeline.plan import AT_ALL_TIMES

    folder = out or f"data/{preset}"
    workers = _workers(context, jobs, backend, scheduler, scheduler_wait)
    with progress("sampling") as shown:
        run(folder, PRESETS[preset], Problem(), jobs=jobs, progress=shown)
    _solve(folder, Settings(), AT_ALL_TIMES, workers)


def verify(
    folder: Folder,
    mend: Annotated[
        bool,
        typer.Option(
            "--repair",
            help="Do damaged shards again; foreign files go to _foreign/, damaged ones to "
            "_damaged/.",
        ),
    ] = False,
    yes: Annotated[
        bool,
        typer.Option(
            "--yes", help="Set files aside, too, that hold sound rows of another dataset."
        ),
    ] = False,
    jobs: Jobs = -1,
    as_json: AsJson = False,
) -> None:
    """Check the integrity of a dataset and the physics of every row.

    Dynamics, ends, separation at all times and fuel are computed anew. `--repair` deletes
    nothing, and leaves files alone that hold sound rows, which the manifest does not expect:
    then it may be the manifest that is wrong. Exit status 1: faults are left.

    Examples:

        prolearn verify data/paper
        prolearn verify data/paper --repair
        prolearn verify data/paper --json
    """
    from pipeline.dataset.verifying import repair
    from pipeline.dataset.verifying import verify as check
    from pipeline.parallel.workers import Workers

    if yes and not mend:
        raise InputError("--yes is given without --repair; expected both, or neither.")
    workers = Workers(jobs)
    with beside(as_json), progress("mending" if mend else "verifying") as shown:
        if mend:
            faults = repair(folder, yes=yes, workers=workers, progress=shown)
        else:
            faults = list(check(folder, workers=workers, progress=shown))
        rows = shown.count
    left = [fault for fault in faults if not mend or (fault.sound and not yes)]
    if as_json:
        told = {"folder": public_url(folder), "repaired": mend, "faults": faults}
        print_json(told if mend else {**told, "rows": rows})
    else:
        _tell(faults, left, public_url(folder), rows, mended=mend)
    raise typer.Exit(int(bool(left)))


def _tell(
    faults: "Sequence[Fault]", left: "Sequence[Fault]", where: str, rows: int, *, mended: bool
) -> None:
    """Say every fault, and what came of them."""
    for fault in faults:
        echo(f"{fault.path}: {fault.what}", err=True)
    many = f"{len(faults)} fault{'s' * (len(faults) != 1)}"
    if not faults:
        echo(f"{where} is sound: {rows} rows.")
    elif not left:
        echo(f"{where} is mended: {many}.")
    elif not mended:
        echo(f"{many} in {where}; mend it: prolearn verify {where} --repair", err=True)
    else:
        echo(
            f"{many} in {where}, of which {len(left)} are left: {left[0].path} holds sound rows, "
            "which the manifest does not expect. Compare the manifest with what you meant to "
            f"make; to set them aside all the same: prolearn verify {where} --repair --yes",
            err=True,
        )


def _refuse_options(context: typer.Context) -> None:
    """Options of `prolearn dataset` say nothing to a command below it."""
    for option in given_options(context).values():
        raise InputError(
            f"{option} is of `prolearn dataset` alone; expected none of its options before "
            f"{context.invoked_subcommand}."
        )


def _workers(
    context: typer.Context,
    jobs: int,
    backend: Backend,
    scheduler: str | None,
    scheduler_wait: float | None,
) -> "Workers":
    """A scheduler in the environment does not turn work on this machine into a fault."""
    from pipeline.parallel.workers import SCHEDULER_WAIT, Workers

    if backend == "loky":
        if "scheduler" in given_options(context):
            raise InputError(
                f"--scheduler is {public_url(scheduler)} and work on this machine has no "
                "scheduler; expected it with --backend dask."
            )
        if scheduler_wait is not None:
            raise InputError(
                f"--scheduler-wait is {scheduler_wait:g} and work on this machine has no "
                "scheduler; expected it with --backend dask."
            )
        return Workers(jobs)
    if not scheduler:
        raise InputError(
            "backend is 'dask' and no scheduler is given; expected its address: "
            "--scheduler tcp://HOST:8786."
        )
    return Workers(jobs, scheduler, SCHEDULER_WAIT if scheduler_wait is None else scheduler_wait)


def _solve(
    folder: str, settings: "Settings", requirements: "Requirements", workers: "Workers"
) -> None:
    from pipeline.dataset.solving import solve as run

    with progress("solving") as shown:
        run(folder, settings, requirements, workers=workers, progress=shown)
    done = f"{shown.count} now, {shown.failed} without a plan"
    echo(f"{public_url(folder)} is solved ({done}).")


def _shares(text: str) -> tuple[float, float, float]:
    try:
        train, valid, test = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(
            f"--shares is {text!r}; expected three numbers such as 0.8,0.1,0.1."
        ) from error
    return train, valid, test
