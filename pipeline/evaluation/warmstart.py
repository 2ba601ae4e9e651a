"""Experiment 3: what a seed saves the expert."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from time import perf_counter

import pandas as pd

from pipeline.evaluation.trials import Predictor
from pipeline.expert import SEEDS, Settings, solve
from pipeline.expert.seeds import Seed
from pipeline.plan import SOLVED
from pipeline.scenario import Scenario

SeedMaker = Callable[[Scenario], Seed] | None

Source = tuple[str, int]
"""Where a seed comes from: a name, and the training seed where it is a network's."""

RULES = {
    "converged": Settings(stop="converged"),
    "first safe": Settings(stop="first-safe"),
}
"""The stopping rules that seeds are compared under."""


@dataclass(frozen=True)
class WarmStart:
    """One run of the expert from one seed.

    Attributes:
        n: swarm size.
        trial: number of the scenario.
        seed: where the seed comes from.
        training_seed: of the network that it comes from, or 0.
        rule: stopping rule, of RULES.
        convex_solves: joint convex programs.
        seconds: time to make the seed and to plan.
        optimality_gap: of the plan.
        fuel: of the plan, m/s².
        safe: whether the plan is proven safe at all times.
        status: of the plan.
    """

    n: int
    trial: int
    seed: str
    training_seed: int
    rule: str
    convex_solves: int
    seconds: float
    optimality_gap: float
    fuel: float
    safe: bool
    status: str


def run_warmstarts(
    predictors: Mapping[Source, Predictor],
    scenarios: Sequence[Scenario],
    *,
    report: Callable[[], None] = lambda: None,
) -> pd.DataFrame:
    """Every seed and rule on every scenario: a row each, columns of WarmStart.

    The seeds of a scenario follow each other directly, begun with another one each time, so
    that the machine's noise falls on all alike.

    Args:
        predictors: networks by name and training seed; their raw predictions are seeds beside
            those of SEEDS.
        scenarios: of any size.
        report: called after each scenario.
    """
    seeds: dict[Source, SeedMaker] = {(name, 0): make for name, make in SEEDS.items()}
    seeds |= {source: _network_seed(predictor) for source, predictor in predictors.items()}
    sources = list(seeds)
    for source in sources if scenarios else []:
        _run(scenarios[0], 0, source, seeds[source], "converged")  # warm up
    rows: list[WarmStart] = []
    for trial, scenario in enumerate(scenarios):
        first = trial % len(sources)
        for source in sources[first:] + sources[:first]:
            rows += [_run(scenario, trial, source, seeds[source], rule) for rule in RULES]
        report()
    return pd.DataFrame([asdict(row) for row in rows])


def _network_seed(predictor: Predictor) -> Callable[[Scenario], Seed]:
    def seed(scenario: Scenario) -> Seed:
        return predictor.predict(scenario.initial[None], scenario.goal[None])[0]

    return seed


def _run(scenario: Scenario, trial: int, source: Source, make: SeedMaker, rule: str) -> WarmStart:
    started = perf_counter()
    seed = None if make is None else make(scenario)
    seeding = perf_counter() - started
    plan = solve(scenario, seed, RULES[rule])
    return WarmStart(
        n=scenario.n,
        trial=trial,
        seed=source[0],
        training_seed=source[1],
        rule=rule,
        convex_solves=plan.convex_solves,
        seconds=seeding + plan.timing["plan"],
        optimality_gap=plan.certificate.optimality_gap,
        fuel=plan.certificate.fuel,
        safe=plan.status == SOLVED,
        status=plan.status,
    )
