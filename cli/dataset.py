"""Commands that make and check datasets: sample, solve, dataset, verify."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from cli.progress import progress
from pipeline.errors import InputError


class Backend(StrEnum):
    """Backends of joblib."""

    LOKY = "loky"
    DASK = "dask"


class SeparationName(StrEnum):
    """When craft are kept apart."""

    CONTINUOUS = "continuous"
    NODES = "nodes"


class SolverName(StrEnum):
    """How the convex subproblem is solved."""

    CLARABEL = "clarabel"
    CVXPY = "cvxpy"


class Preset(StrEnum):
    """Datasets by name."""

    DEMO = "demo"
    PAPER = "paper"


def _checked_jobs(jobs: int) -> int:
    if jobs == 0:
        raise InputError("--jobs is 0; expected a number of processes, or -1 for all cores.")
    return jobs


Jobs = Annotated[int, typer.Option(help="Processes; -1 for all cores.", callback=_checked_jobs)]
Out = Annotated[Path, typer.Option(help="Dataset folder.", show_default=False)]
Folder = Annotated[Path, typer.Argument(help="Dataset folder.", show_default=False)]
BackendOption = Annotated[
    Backend, typer.Option(help="Where workers run: this machine, or a Dask cluster.")
]


def sample(
    out: Out,
    n: Annotated[int, typer.Option("--n", help="Spacecraft in each scenario.")] = 10,
    count: Annotated[int, typer.Option(help="Scenarios to draw.")] = 1000,
    seed: Annotated[int, typer.Option(help="Root seed.")] = 0,
    family: Annotated[
        str,
        typer.Option(
            help="rings, coplanar-split, tilt-split, independent or rotation.",
        ),
    ] = "rings",
    shares: Annotated[
        str, typer.Option(help="Shares of the train, valid and test split.")
    ] = "0.8,0.1,0.1",
    altitude: Annotated[float, typer.Option(help="Of the reference orbit, m.")] = 500e3,
    time_step: Annotated[float, typer.Option(help="Length of an interval, s.")] = 120.0,
    nodes: Annotated[int, typer.Option(help="Time nodes.")] = 11,
    collision_radius: Annotated[float, typer.Option(help="r_col, m.")] = 15.0,
    max_acceleration: Annotated[
        float | None, typer.Option(help="Limit on each component, m/s².")
    ] = None,
    jobs: Jobs = -1,
) -> None:
    """Draw scenarios into a dataset folder.

    Scenario k depends on seed, n and k alone. Several sizes may share a folder.

    Example:

        prolearn sample --n 10 --count 10000 --seed 0 --out data/n10
    """
    from pipeline.dataset.manifest import Sample
    from pipeline.dataset.sample import sample as run
    from pipeline.dataset.sample import to_draw
    from pipeline.orbit.cw import mean_motion_at
    from pipeline.orbit.problem import Problem

    if not altitude > 0:
        raise InputError(f"--altitude is {altitude}; expected a positive number of metres.")
    problem = Problem(
        mean_motion_at(altitude), time_step, nodes, collision_radius, max_acceleration
    )
    one = Sample(family=family, seed=seed, count=count, shares=_shares(shares))
    with progress("sampling", to_draw(out, {n: one}, problem)) as advance:
        run(out, {n: one}, problem, jobs=jobs, report=lambda done, failed: advance(done, ""))
    typer.echo(f"{count} scenarios of n={n} are in {out}; solve them: prolearn solve {out}")


def solve(
    folder: Folder,
    jobs: Jobs = -1,
    backend: BackendOption = Backend.LOKY,
    separation: Annotated[
        SeparationName, typer.Option(help="Keep craft apart at all times, or at the nodes only.")
    ] = SeparationName.CONTINUOUS,
    solver: Annotated[
        SolverName, typer.Option(help="Clarabel directly, or the readable form in cvxpy.")
    ] = SolverName.CLARABEL,
) -> None:
    """Solve the scenarios of a folder with the expert.

    What is solved already is kept: after an interruption run the same command again.

    Examples:

        prolearn solve data/n10
        prolearn solve data/n10 --jobs 8 --separation nodes
    """
    _solve(folder, jobs, backend, separation, solver)


def make(
    preset: Annotated[Preset, typer.Option(help="Which dataset.")] = Preset.PAPER,
    out: Annotated[
        Path | None, typer.Option(help="Dataset folder; data/PRESET by default.")
    ] = None,
    jobs: Jobs = -1,
    backend: BackendOption = Backend.LOKY,
) -> None:
    """Sample and solve all that the experiments need.

    The paper's: 8000 + 1000 + 1000 scenarios of n=10, and 100 test trials of each n=2..30.

    Examples:

        prolearn dataset --preset demo --out data/demo
        prolearn dataset --preset paper
    """
    from pipeline.dataset.presets import PRESETS
    from pipeline.dataset.sample import sample as run
    from pipeline.dataset.sample import to_draw
    from pipeline.orbit.problem import Problem

    folder = out or Path("data") / preset
    samples, problem = PRESETS[preset], Problem()
    with progress("sampling", to_draw(folder, samples, problem)) as advance:
        run(folder, samples, problem, jobs=jobs, report=lambda done, failed: advance(done, ""))
    _solve(folder, jobs, backend, SeparationName.CONTINUOUS, SolverName.CLARABEL)


def verify(folder: Folder) -> None:
    """Check the integrity of a dataset and the physics of every row.

    Example:

        prolearn verify data/paper
    """
    from pipeline.dataset.manifest import read_manifest
    from pipeline.dataset.verify import verify as run

    total = sum(sample.count for sample in read_manifest(folder).samples.values())
    with progress("verifying", total) as advance:
        faults = list(run(folder, report=lambda rows: advance(rows, "")))
    for fault in faults:
        typer.echo(f"{fault.path}: {fault.what}", err=True)
    if faults:
        typer.echo(f"{len(faults)} faults in {folder}; `prolearn solve {folder}` redoes shards.")
        raise typer.Exit(1)
    typer.echo(f"{folder} is sound: {total} rows.")


def _solve(
    folder: Path,
    jobs: int,
    backend: Backend,
    separation: SeparationName,
    solver: SolverName,
) -> None:
    from pipeline.dataset.solve import solve as run
    from pipeline.dataset.solve import to_solve
    from pipeline.expert import Settings

    settings = Settings(separation=separation.value, solver=solver.value)
    counts = {"done": 0, "failed": 0}
    with progress("solving", to_solve(folder, settings)) as advance:

        def report(done: int, failed: int) -> None:
            counts["done"] += done
            counts["failed"] += failed
            advance(done, f"{counts['failed'] / counts['done']:.1%} failed")

        run(folder, settings, jobs=jobs, backend=backend.value, report=report)
    typer.echo(f"{folder} is solved ({counts['done']} now, {counts['failed']} without a plan).")


def _shares(text: str) -> tuple[float, float, float]:
    try:
        train, valid, test = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(
            f"--shares is {text!r}; expected three numbers such as 0.8,0.1,0.1."
        ) from error
    return train, valid, test
