"""A scenario's fuel against its transfer time: plans, table and figure in a folder."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cli.settings import Tradeoff
from pipeline.figures.style import save
from pipeline.files import refuse_unwritable, write_rows
from pipeline.plan.document import write_plan
from pipeline.plan.plan import summary
from pipeline.planners.planner import Planner
from pipeline.progress import SILENT, Progress
from pipeline.scenario.document import read_checked
from pipeline.tradeoff import Point, arcs_between, knee_of, tradeoff, tradeoff_figure

TABLE = "tradeoff.csv"
PLANS = "plans"  # folder of the plans within that of the trade-off
PLAN = "transfer-{}s.plan.json"  # name of a plan's file, by its duration in s

NOT_IN_CSV = (
    *("min_separation_pair", "assignment", "risk", "largest_share", "smallest_burn"),
    *("passive_safety", "clearance", "corridor"),
    *("craft_delta_v", "craft_delta_v_2norm", "craft_delta_v_thrusters", "craft_share"),
)
"""Fields of a row that are neither numbers nor text; the plan files have them."""


def trade(
    path: Path,
    planner: Planner,
    out: Path,
    settings: Tradeoff,
    durations: tuple[float, float],
    progress: Progress = SILENT,
) -> Sequence[dict[str, Any]]:
    """Plan a scenario for several durations (s) and write the plans, a table and a figure.

    Only safe plans are written as files. Those of an earlier trade-off in the folder are removed.
    A row is a plan's summary with ``duration`` (s), ``nodes``, ``time_step``,
    ``delta_v_lower_bound``, whether it is the ``knee``, and the file of the ``plan`` or None.
    """
    for file in (out / TABLE, out / PLANS / PLAN):
        refuse_unwritable(file)
    drift = settings.allow_drift
    scenario = read_checked(path, allow_drift=drift)
    step = scenario.problem.time_step
    arcs = arcs_between(*durations, step, settings.steps)
    points = tradeoff(scenario, arcs, planner, settings.goal, progress, allow_drift=drift)
    bend = knee_of(points)
    rows = [_row(point, out, knee=k == bend) for k, point in enumerate(points)]
    for point, row in zip(points, rows, strict=True):
        if row["plan"]:
            write_plan(Path(row["plan"]), point.plan)
    kept = {row["plan"] for row in rows}
    for old in (out / PLANS).glob(PLAN.format("*")):
        if str(old) not in kept:
            old.unlink()
    _write_table(rows, out / TABLE)
    title = f"{scenario.headline}, arcs of {step:g} s, {settings.goal} goals"
    save(tradeoff_figure(points, bend, title), out / "tradeoff")
    return rows


def _row(point: Point, out: Path, *, knee: bool) -> dict[str, Any]:
    problem = point.plan.scenario.problem
    file = out / PLANS / PLAN.format(f"{point.duration:.9g}")
    return {
        "duration": point.duration,
        "nodes": problem.nodes,
        "time_step": problem.time_step,
        **summary(point.plan),
        "delta_v_lower_bound": point.delta_v_lower_bound,
        "knee": knee,
        "plan": str(file) if point.safe else None,
    }


def _write_table(rows: Sequence[dict[str, Any]], path: Path) -> None:
    names = [name for name in rows[0] if name not in NOT_IN_CSV]
    table = (
        [*(row[name] for name in names), *(row["min_separation_pair"] or (None, None))]
        for row in rows
    )
    write_rows(path, [*names, "first_craft", "second_craft"], table)
