"""Commands that run the experiments, from evaluate to ablate, and the report."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.app import float_list, int_list, name_list
from cli.output import AsJson, beside, echo, print_json
from cli.progress import progress
from pipeline.experiments.records import EXPERT, PLAIN

if TYPE_CHECKING:
    from registry.results import Done

Models = Annotated[
    str | None,
    typer.Option(
        help="Models, such as ff1,lstm2:paper; by default the newest trained on the data.",
        show_default=False,
    ),
]
Data = Annotated[
    str, typer.Option(help="Solved dataset, a folder or a URL; its test split is used.")
]
Resume = Annotated[
    bool,
    typer.Option(
        "--resume", help="Nothing to do where data, models, settings and versions are as before."
    ),
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
    resume: Resume = False,
    as_json: AsJson = False,
) -> None:
    """Experiments 1 and 2: collisions, fuel and time against swarm size.

    Networks, expert and baselines plan the same test scenarios.

    Examples:

        prolearn evaluate
        prolearn evaluate --models ff1,lstm2 --n 2..30 --data data/paper
    """
    from cli.stages.evaluate import evaluate as run

    sizes = None if n is None else int_list(n)
    with beside(as_json), progress("evaluating") as shown:
        outcome = run(
            name_list(models),
            data,
            sizes=sizes,
            trials=trials,
            timed=timed,
            resume=resume,
            progress=shown,
        )
    _done("Evaluated", outcome, as_json=as_json)


class Optimizer(StrEnum):
    """What the seeds of experiment 3 are given to."""

    EXPERT = EXPERT
    PLAIN = PLAIN


SIZES = {Optimizer.EXPERT: "10,30", Optimizer.PLAIN: "10"}
"""Swarm sizes of experiment 3 where none are given."""


def warmstart(
    models: Models = None,
    data: Data = "data/paper",
    optimizer: Annotated[
        Optimizer,
        typer.Option(
            help="The expert, or a plain SCP over all pairs at the nodes, as the paper's."
        ),
    ] = Optimizer.EXPERT,
    n: Annotated[
        str | None,
        typer.Option(
            "--n",
            help="Swarm sizes; by default 10,30 for the expert and 10 for the plain SCP.",
            show_default=False,
        ),
    ] = None,
    trials: Annotated[int, typer.Option(help="Trials of each size.")] = 100,
    resume: Resume = False,
    as_json: AsJson = False,
) -> None:
    """Experiment 3: start an optimizer from each network's plan and from simple seeds.

    Networks, straight line, minimum energy and the own LPs give seeds; the report sets both
    optimizers side by side.

    Examples:

        prolearn warmstart --models ff1,ffcol --n 10 --trials 100
        prolearn warmstart --optimizer plain
    """
    from cli.stages.warmstart import warmstart as run

    sizes = int_list(SIZES[optimizer] if n is None else n)
    with beside(as_json), progress("warm starts") as shown:
        outcome = run(
            name_list(models),
            data,
            sizes=sizes,
            trials=trials,
            optimizer=optimizer.value,
            resume=resume,
            progress=shown,
        )
    _done("Warm starts done", outcome, as_json=as_json)


def transfer_times(
    models: Models = None,
    data: Data = "data/paper",
    n: Annotated[int, typer.Option("--n", help="Swarm size.")] = 10,
    nodes: Annotated[
        str, typer.Option(help="Numbers of nodes T, at the time step of the training.")
    ] = "6..21",
    time_step: Annotated[
        str | None,
        typer.Option(
            help="Time steps Δt in s, at the nodes of the training; by default those with the "
            "transfer times of --nodes.",
            show_default=False,
        ),
    ] = None,
    trials: Annotated[int, typer.Option(help="Most trials of each transfer time.")] = 100,
    resume: Resume = False,
    as_json: AsJson = False,
) -> None:
    """Experiment 4: transfer times that no network was trained for.

    The same ends with other nodes T and with other time steps Δt. Feed-forward networks have
    weights for one T alone; at other T, LSTMs, the refiner, experts and baselines take part.

    Examples:

        prolearn transfer-times
        prolearn transfer-times --models lstm2 --nodes 6,11,16 --time-step 60,240
    """
    from cli.stages.transfer_times import transfer_times as run

    grids = int_list(nodes, "--nodes")
    steps = None if time_step is None else float_list(time_step, "--time-step")
    with beside(as_json), progress("transfer times") as shown:
        outcome = run(
            name_list(models),
            data,
            n=n,
            nodes=grids,
            time_steps=steps,
            trials=trials,
            resume=resume,
            progress=shown,
        )
    _done("Transfer times done", outcome, as_json=as_json)


def flights(
    models: Annotated[
        str | None,
        typer.Option(
            help="Networks that answer on any time grid, such as refiner,lstm2; by default the "
            "newest refiners trained on the data.",
            show_default=False,
        ),
    ] = None,
    data: Data = "data/paper",
    n: Annotated[int, typer.Option("--n", help="Swarm size.")] = 10,
    trials: Annotated[int, typer.Option(help="Most scenarios.")] = 100,
    flights: Annotated[
        int, typer.Option(help="Flights of each scenario, each with other errors.")
    ] = 10,
    seed: Annotated[int, typer.Option(help="Root seed of the errors.")] = 0,
    jobs: Annotated[int, typer.Option(help="Processes; -1 for one a core.")] = -1,
    resume: Resume = False,
    as_json: AsJson = False,
) -> None:
    """Experiment 5: what flies.

    Plans of expert, networks and baselines are flown in the linear model and about an oblate
    Earth, without and with errors of thrust and navigation: as they are, made anew at every node,
    and with margin. The expert makes a network's plans safe where they are not.

    Examples:

        prolearn flights
        prolearn flights --n 10 --trials 20 --flights 5 --seed 1
    """
    from cli.stages.flights import flights as run

    with beside(as_json), progress("flying") as shown:
        outcome = run(
            name_list(models),
            data,
            n=n,
            trials=trials,
            flights=flights,
            seed=seed,
            jobs=jobs,
            resume=resume,
            progress=shown,
        )
    _done("Flights done", outcome, as_json=as_json)


def ablate(
    models: Annotated[
        str | None,
        typer.Option(
            help="Refiners, such as refiner:tuned,refiner:no-third; by default the newest of each "
            "recipe trained on the data.",
            show_default=False,
        ),
    ] = None,
    data: Data = "data/paper",
    n: Annotated[str, typer.Option("--n", help="Swarm sizes.")] = "10,30",
    rounds: Annotated[
        str, typer.Option(help="Numbers of rounds, beside those of the refiners' answers.")
    ] = "0,1,2,3,4,6,8,12,16,20,30",
    trials: Annotated[int | None, typer.Option(help="Most trials of each size.")] = None,
    dense: Annotated[
        int, typer.Option(help="Swarms of ten of the family dense, drawn to be tried, too.")
    ] = 300,
    timed: Annotated[int, typer.Option(help="Trials of each size that are timed.")] = 10,
    resume: Resume = False,
    as_json: AsJson = False,
) -> None:
    """Ablations: refiners that lack one thing each, beside the rule without learning.

    All plan the same test scenarios; those that lack nothing and the rule after other numbers of
    rounds, too. `make ablate` trains the refiners first.

    Examples:

        prolearn ablate
        prolearn ablate --n 10 --rounds 4,8,16 --trials 200
    """
    from cli.stages.ablate import ablate as run

    sizes, counts = int_list(n), int_list(rounds, "--rounds", least=0)
    with beside(as_json), progress("ablations") as shown:
        outcome = run(
            name_list(models),
            data,
            sizes=sizes,
            rounds=counts,
            trials=trials,
            dense=dense,
            timed=timed,
            resume=resume,
            progress=shown,
        )
    _done("Ablations done", outcome, as_json=as_json)


def report(
    out: Annotated[Path, typer.Option(help="Folder for the report.")] = Path("reports"),
    evaluation: Annotated[
        str | None,
        typer.Option(help="Run of the evaluation; the newest by default.", show_default=False),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write tables, figures and the report of an evaluation.

    Warm starts, transfer times and trainings go in where they are of the same models on the same
    data, flights and ablations where they are on the same data; the report says what is missing
    or was made with other versions.

    Examples:

        prolearn report --out reports/
        prolearn report --evaluation 0123456789abcdef0123456789abcdef
    """
    from cli.stages.report import report as run

    with beside(as_json):
        files = run(out, evaluation)
    if as_json:
        print_json(files)
        return
    echo(f"The report is {files.html} (and {files.markdown}).")


def _done(what: str, outcome: "Done", *, as_json: bool) -> None:
    if as_json:
        from cli.stages.averages import averages

        with beside(as_json):
            rows = averages(outcome.run_id)
        print_json({**vars(outcome), "averages": rows})
        return
    when = " before" if outcome.earlier else ""
    echo(f"{what}{when}; MLflow run {outcome.run_id}. Next: prolearn report")
