"""The table of a Monte Carlo: a column for each way to fly, a row for each quantity."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from cli.output import print_table
from pipeline.exhibits.numbers import MISSING, number, percents, share

if TYPE_CHECKING:
    from pipeline.flight.summary import Summary


def print_trials(summaries: "Sequence[Summary]", radius: float, size: float) -> None:
    """Print it, in 80 columns for three ways to fly."""
    shares = {f"within r_col, {radius:g} m": "within_radius", f"within {size:g} m": "within_size"}
    lines = [[label, *(_shared(one, name) for one in summaries)] for label, name in shares.items()]
    for label, name, scale in QUANTITIES:
        if any(getattr(one, name) is not None for one in summaries):
            lines.append([label, *(_number(getattr(one, name), scale) for one in summaries)])
    print_table(["", *(one.loop for one in summaries)], lines)


QUANTITIES: Sequence[tuple[str, str, float]] = (
    ("least separation, m: median", "separation_median", 1.0),
    ("  least of all", "least_separation", 1.0),
    ("error at goal, m: median", "goal_error_median", 1.0),
    ("  95 %", "goal_error_high", 1.0),
    ("  mm/s: median", "goal_velocity_error_median", 1e3),
    ("  95 %", "goal_velocity_error_high", 1e3),
    ("Δv, m/s: median", "delta_v_median", 1.0),
    ("  95 %", "delta_v_high", 1.0),
    ("missed burns a trial", "missed_burns", 1.0),
    ("margin, m", "margin", 1.0),
    ("nodes without a safe plan", "unsafe_replans", 1.0),
    ("time a replan, ms: median", "replan_seconds", 1e3),
)
"""Label, field of a summary, and what its unit is multiplied by."""


def _shared(one: "Summary", name: str) -> str:
    value, interval = getattr(one, name), getattr(one, f"{name}_interval")
    return MISSING if value is None else f"{share(value)} {percents(*interval)}"


def _number(value: float | None, scale: float) -> str:
    return MISSING if value is None else number(scale * value)
