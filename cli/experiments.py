"""Commands that run the experiments, from evaluate to flights, and the report."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.options import with_settings, workers_of
from cli.output import print_result, stdout_for_document
from cli.progress import progress
from cli.settings import (
    AsJson,
    Evaluation,
    Flights,
    Resume,
    RunSettings,
    TransferTimes,
    WarmStarts,
    option,
)

if TYPE_CHECKING:
    from registry.results import Recorded


@with_settings
def evaluate(context: typer.Context, settings: Evaluation, how: RunSettings) -> None:
    """Experiments 1 and 2: collisions, fuel and time against swarm size.

    Networks, expert and baselines plan the same test scenarios. Those that are timed are planned
    on one thread of this machine first, before workers begin with the rest.

    Examples:

        prolearn evaluate
        prolearn evaluate --models ff1,lstm2 --n 2..30 --data data/paper
    """
    from cli.jobs.experiments import evaluate as job

    _run("evaluating", "Evaluated", job, settings, how, context)


@with_settings
def warmstart(settings: WarmStarts, resume: Resume = False, as_json: AsJson = False) -> None:
    """Experiment 3: start an optimizer from each network's plan and from simple seeds.

    Networks, straight line, minimum energy and the decoupled optima give seeds; the report sets
    both optimizers side by side. The time of each start is measured, so it runs on one thread of
    this machine: workers beside it would change the times.

    Examples:

        prolearn warmstart --models ff1,ffcol --n 10 --trials 100
        prolearn warmstart --optimizer plain
    """
    from cli.jobs.experiments import warmstart as job

    how = RunSettings(resume=resume, as_json=as_json)
    _run("warm starts", "Warm starts done", job, settings, how)


@with_settings
def transfer_times(context: typer.Context, settings: TransferTimes, how: RunSettings) -> None:
    """Experiment 4: transfer times that no network was trained for.

    The same end states with other numbers of nodes T and other time steps Δt. Feed-forward
    networks have weights for one T alone; at other T, LSTMs, the refiner, experts and baselines
    take part.

    Examples:

        prolearn transfer-times
        prolearn transfer-times --models lstm2 --nodes 6,11,16 --time-step 60,240
    """
    from cli.jobs.experiments import transfer_times as job

    _run("transfer times", "Transfer times done", job, settings, how, context)


@with_settings
def flights(context: typer.Context, settings: Flights, how: RunSettings) -> None:
    """Experiment 5: plans flown with nonlinear dynamics and with errors.

    Plans of expert, networks and baselines are flown in the linear model and about an oblate
    Earth, without and with errors of thrust and navigation: in open loop, for a risk with
    feedback, and replanned at every node without and with a margin. The expert makes a network's
    plans safe where they are not. Plans made as flown, also about eccentric orbits, are flown
    without errors. Swarms of n = 30 fly about the usual orbit, too, where the data have them.

    Examples:

        prolearn flights
        prolearn flights --n 10 --trials 20 --flights 5 --seed 1
    """
    from cli.jobs.experiments import flights as job

    _run("flying", "Flights done", job, settings, how, context)


def _run(
    doing: str,
    done: str,
    job: Callable[..., "Recorded"],
    settings: object,
    how: RunSettings,
    context: typer.Context | None = None,
) -> None:
    """Run an experiment, by workers of its own if it has a context, and print its run."""
    from cli.jobs.run_tables import averages

    workers = None if context is None else workers_of(context, how)
    with stdout_for_document(how.as_json), progress(doing) as shown:
        by = {"workers": workers.with_progress(shown)} if workers else {"progress": shown}
        outcome = job(settings, resume=how.resume, **by)
        rows = averages(outcome.run_id) if how.as_json else []
    when = " before" if outcome.earlier else ""
    said = f"{done}{when}; MLflow run {outcome.run_id}. Next: prolearn report"
    print_result(how.as_json, {**vars(outcome), "averages": rows}, said)


def report(
    out: Annotated[Path, option("Folder for the report.")] = Path("reports"),
    evaluation: Annotated[
        str | None, option("Run of the evaluation; the newest by default.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write tables, figures and the report of an evaluation.

    It includes warm starts, transfer times and trainings of the same models on the same data, and
    flights on the same data; it says what is missing or was made with other versions.

    Examples:

        prolearn report --out reports/
        prolearn report --evaluation 0123456789abcdef0123456789abcdef
    """
    from cli.jobs.report import report as job

    with stdout_for_document(as_json):
        files = job(out, evaluation)
    print_result(as_json, files, f"The report is {files.html} (and {files.markdown}).")
