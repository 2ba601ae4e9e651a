"""Commands that run the paper's experiments and report on them: evaluate, warmstart, report."""

from pathlib import Path
from typing import Annotated

import typer

from cli.app import int_list, name_list
from cli.progress import progress

Models = Annotated[
    str | None,
    typer.Option(
        help="Models, such as ff1,lstm2:paper; by default the newest of each recipe.",
        show_default=False,
    ),
]
Data = Annotated[
    str, typer.Option(help="Solved dataset, a folder or a URL; its test split is used.")
]


def evaluate(
    models: Models = None,
    data: Data = "data/paper",
    n: Annotated[
        str | None,
        typer.Option("--n", help="Swarm sizes, such as 2..30; by default all of the dataset."),
    ] = None,
    trials: Annotated[int | None, typer.Option(help="Most trials of each size.")] = None,
    timed: Annotated[int, typer.Option(help="Trials of each size that are timed.")] = 10,
) -> None:
    """Experiments 1 and 2: collisions, fuel and time against swarm size.

    Networks, expert and baselines plan the same test scenarios.

    Examples:

        prolearn evaluate
        prolearn evaluate --models ff1,lstm2 --n 2..30 --data data/paper
    """
    from pipeline.dataset.manifest import read_manifest
    from registry.jobs.evaluate import evaluate as run

    sizes = int_list(n)
    total = len(sizes or read_manifest(data).samples)
    with progress("evaluating", total) as advance:
        run_id = run(
            name_list(models),
            data,
            sizes=sizes,
            trials=trials,
            timed=timed,
            report=lambda stage: advance(1, stage),
        )
    typer.echo(f"Evaluated; MLflow run {run_id}. Next: prolearn report")


def warmstart(
    models: Models = None,
    data: Data = "data/paper",
    n: Annotated[str, typer.Option("--n", help="Swarm sizes.")] = "10,30",
    trials: Annotated[int, typer.Option(help="Trials of each size.")] = 100,
) -> None:
    """Experiment 3: start the expert from each network's plan and from simple seeds.

    Example:

        prolearn warmstart --models ff1,ffcol --n 10 --trials 100
    """
    from registry.jobs.warmstart import warmstart as run

    sizes = int_list(n) or []
    with progress("warm starts", trials * len(sizes)) as advance:
        run_id = run(
            name_list(models),
            data,
            sizes=sizes,
            trials=trials,
            report=lambda done: advance(done, ""),
        )
    typer.echo(f"Warm starts done; MLflow run {run_id}. Next: prolearn report")


def report(
    out: Annotated[Path, typer.Option(help="Folder for the report.")] = Path("reports"),
) -> None:
    """Write tables, figures and the report from the newest results.

    Example:

        prolearn report --out reports/
    """
    from registry.jobs.report import report as run

    files = run(out)
    typer.echo(f"The report is {files.html} (and {files.markdown}).")
