"""Runs of experiment 3: the expert, and a plain SCP like the paper's, timed from each seed."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from time import perf_counter

import pandas as pd
from threadpoolctl import threadpool_limits

from pipeline.experiments.parts import FinishedParts, Part, finish_parts
from pipeline.experiments.records import CONVERGED, EXPERT, FIRST_SAFE, PLAIN, WarmStart
from pipeline.experiments.trials import Predictor, flies_safely
from pipeline.expert import EFFORTS, SEEDS, solve
from pipeline.expert.seeds import Seed, decoupled_seed
from pipeline.parallel.workers import Workers
from pipeline.plan.plan import Plan
from pipeline.progress import SILENT, Progress
from pipeline.scenario import Scenario

RULES = {CONVERGED: EFFORTS["default"], FIRST_SAFE: EFFORTS["first"]}
"""The stopping rules that seeds are compared under; the plain SCP knows "converged" alone."""

Source = tuple[str, int]
"""Where a seed comes from: a name, and the training seed where it is a network's."""

SeedMaker = Callable[[Scenario], Seed] | None
Optimize = Callable[[Scenario, Seed | None], Plan]


def run_warmstarts(
    predictors: Mapping[Source, Predictor],
    sizes: Sequence[Sequence[Scenario]],
    optimizer: str = EXPERT,
    *,
    kept: FinishedParts | None = None,
    progress: Progress = SILENT,
) -> pd.DataFrame:
    """Every seed and rule on every scenario: a row each, columns of WarmStart.

    All run on one thread of this process. The seeds of a scenario follow each other directly, from
    a different first one each time, so that the machine's load affects all alike. Raw predictions
    of networks, by name and training seed, are seeds beside those of SEEDS. Progress counts
    scenarios.
    """
    seeds: dict[Source, SeedMaker] = {(name, 0): make for name, make in SEEDS.items()}
    if optimizer == PLAIN:
        seeds["decoupled optimum", 0] = decoupled_seed  # the expert's own start
    seeds |= {source: partial(_network_seed, predictor) for source, predictor in predictors.items()}
    parts = []
    for some in filter(None, sizes):
        rules = _rules(optimizer, some[0])
        parts += [Part((one, trial, rules), one.n) for trial, one in enumerate(some)]
        with threadpool_limits(1):
            for make in seeds.values():
                _run(some[0], make, rules[CONVERGED])  # warm up
                if make is not None:
                    for scenario in some[1:]:
                        make(scenario)  # some code of networks runs for near pairs alone
    here, run = Workers(jobs=1, progress=progress), partial(_run_seeds, optimizer, seeds)
    tables = finish_parts("starts", run, parts, workers=here, kept=kept)
    return pd.concat(tables, ignore_index=True)


def _run_seeds(
    optimizer: str,
    seeds: Mapping[Source, SeedMaker],
    part: tuple[Scenario, int, Mapping[str, Optimize]],
) -> pd.DataFrame:
    """Rows of experiment 3 for one scenario: every seed under each stopping rule."""
    scenario, trial, rules = part
    sources = list(seeds)
    first, rows = trial % len(sources), []
    for source in sources[first:] + sources[:first]:
        for rule, optimize in rules.items():
            plan, seconds = _run(scenario, seeds[source], optimize)
            rows.append(
                WarmStart(
                    optimizer=optimizer,
                    n=scenario.n,
                    trial=trial,
                    seed=source[0],
                    training_seed=source[1],
                    rule=rule,
                    convex_solves=plan.convex_solves,
                    seconds=seconds,
                    optimality_gap=plan.optimality_gap,
                    fuel=plan.certificate.fuel,
                    safe=flies_safely(plan),
                    status=plan.status,
                )
            )
    return pd.DataFrame(rows)


def _rules(optimizer: str, scenario: Scenario) -> dict[str, Optimize]:
    """The optimizer under each of its stopping rules, ready for scenarios like this one."""
    if optimizer == PLAIN:
        from pipeline.expert.plain import PlainScp

        return {CONVERGED: PlainScp(scenario.n, scenario.problem).solve}
    return {rule: partial(solve, settings=settings) for rule, settings in RULES.items()}


def _run(scenario: Scenario, make: SeedMaker, optimize: Optimize) -> tuple[Plan, float]:
    """A plan, and the time to make the seed and to plan, s."""
    started = perf_counter()
    seed = None if make is None else make(scenario)
    seeding = perf_counter() - started
    plan = optimize(scenario, seed)
    return plan, seeding + plan.timing["plan"]


def _network_seed(predictor: Predictor, scenario: Scenario) -> Seed:
    return predictor(scenario.initial[None], scenario.goal[None])[0]
