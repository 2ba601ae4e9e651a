"""Plans made for the linear model beside plans made as flown, both flown without errors.

    python -m benchmarks.as_flown --out reports/bench

The expert and the packaged refiner plan the scenarios of `prolearn scenario new --index`; all else
is as in experiment 5. Prints the table, and writes as_flown.json.
"""

import pandas as pd
import typer
from threadpoolctl import threadpool_limits

from benchmarks.tables import BENCH, OutOption, show, write_json
from pipeline.experiments.experiment5 import in_both_models, summarize_flights
from pipeline.experiments.flights import run_flights
from pipeline.experiments.trials import EvaluatedPlanner
from pipeline.networks.refiner.model import packaged
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers
from pipeline.planners.classical import Expert
from pipeline.planners.network import FallbackPlanner, NetworkPlanner
from pipeline.scenario import draw

COUNTS = {10: 100, 30: 30}  # scenarios by swarm size

COLUMNS = {
    "n": "n",
    "world": "orbit",
    "planner": "planner",
    "planned": "planned",
    "within_radius_share": "within r_col",
    "separation_min": "least separation",
    "goal_error_median": "off goal, median",
    "goal_error_most": "largest",
    "over_linear_mean": "Δv / linear plan's",
}


def main(out: OutOption = BENCH) -> None:
    """Run all and print the table."""
    refiner = FallbackPlanner(NetworkPlanner(packaged(), "refiner"))
    planners, tables = [EvaluatedPlanner(Expert()), EvaluatedPlanner(refiner)], []
    with threadpool_limits(1):
        for n, count in COUNTS.items():
            drawn = [draw("rings", 0, n, k, Problem(), "test") for k in range(count)]
            tables.append(run_flights(planners, [], flights=1, larger=drawn, workers=Workers(1)))
    summary = in_both_models(summarize_flights(pd.concat(tables, ignore_index=True)))
    rows = summary[list(COLUMNS)].rename(columns=COLUMNS)
    show("Plans flown without errors, SI units", rows.to_dict("records"))
    write_json(out / "as_flown.json", rows.to_dict("records"))


if __name__ == "__main__":
    typer.run(main)
