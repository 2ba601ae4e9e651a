"""A plan flown many times with errors: trials, table and figure in a folder."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from cli.jobs.planner import planner_of
from cli.settings import FlownTrials
from pipeline.errors import InputError, check_range
from pipeline.figures.style import save
from pipeline.figures.tables import write_csv
from pipeline.files import refuse_dataset
from pipeline.flight.errors import Errors
from pipeline.flight.loops import MOST_SIGMAS, SIGMAS, TrialSettings, flight_loops
from pipeline.flight.montecarlo import fly_all
from pipeline.flight.summary import Summary, summarize, trials_figure
from pipeline.flight.world import Conditions, LinearWorld, World, world_of
from pipeline.parallel.workers import Workers
from pipeline.plan.plan import Plan
from pipeline.scenario import Scenario
from pipeline.scenario.scenario import FURTHEST

TABLE, FIGURE = "trials.csv", "trials"  # names of the files beside the trials


def fly_trials(
    plan: Plan,
    conditions: Conditions,
    errors: Errors,
    out: Path,
    settings: FlownTrials,
    *,
    workers: Workers,
) -> Sequence[Summary]:
    """Fly a plan many times, in open and closed loop, into a folder; a summary of each loop."""
    scenario, size, trials = plan.scenario, settings.size, settings.trials or 0
    world = _world(scenario, conditions, settings)
    with_feedback, planner = settings.replan == "feedback", None
    if settings.replan == "every-node":
        planner = planner_of(settings.planner, plan.requirements, settings.effort)
    if out.exists() and not out.is_dir():
        raise InputError(f"--out is the file {out}; expected a folder.")
    refuse_dataset(out)
    check_range("--size", size, 0.0, FURTHEST)
    sigmas = SIGMAS if settings.sigmas is None else settings.sigmas
    check_range("--sigmas", sigmas, 0.0, MOST_SIGMAS)
    trial_settings = TrialSettings(scenario, world, errors, settings.seed)
    loops = list(flight_loops(plan, errors, planner, sigmas, with_feedback=with_feedback))
    tables = fly_all(out, trial_settings, loops, trials, workers=workers)
    radius = scenario.problem.collision_radius
    summaries = [summarize(loop, tables[loop.name], radius, size) for loop in loops]
    _write_table(summaries, out / TABLE)
    title = f"{scenario.headline}, {trials} trials in the {settings.world} world"
    save(trials_figure(tables, radius, size, title), out / FIGURE)
    return summaries


def _world(scenario: Scenario, conditions: Conditions, settings: FlownTrials) -> World:
    if settings.world == "nonlinear":
        return world_of(scenario, conditions)
    if settings.device is None:
        return LinearWorld(scenario.problem.dynamics)
    from pipeline.networks.device import torch_device

    return LinearWorld(scenario.problem.dynamics, str(torch_device(settings.device)))


def _write_table(summaries: Sequence[Summary], path: Path) -> None:
    table = pd.DataFrame([one.document() for one in summaries])
    for name in [name for name in map(str, table) if name.endswith("_interval")]:
        ends = [pair or (None, None) for pair in table.pop(name)]
        stem = name.removesuffix("_interval")
        table[[f"{stem}_low", f"{stem}_high"]] = pd.DataFrame(ends)
    write_csv(table, path)
