"""Plans and rows of our own, put before the judge: fields are handed over, nothing is computed."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd
from judge import Report, judge_plan


def judged(scenario: Any, plan: Any, **options: Any) -> Report:
    """The judge's report on a Scenario and a Plan."""
    fields = {"states": plan.states, "controls": plan.controls}
    claims = {"certificate": asdict(plan.certificate)}
    return judge_plan(document(scenario), fields | claims, **options)


def document(scenario: Any) -> dict[str, Any]:
    """The fields of scenario.json."""
    fields = asdict(scenario.problem)
    thrust = fields.pop("thrust")
    craft = [asdict(one) for one in scenario.craft]
    ends = {"initial": scenario.initial, "goal": scenario.goal}
    return {**fields, "thrust": thrust.pop("model"), **thrust, "craft": craft, **ends}


def check_rows(rows: pd.DataFrame, reports: Sequence[Report]) -> None:
    """That an experiment's rows of one planner, in order of trial, say what the judge found."""
    assert list(rows["safe"]) == [report.wrong == () for report in reports]
    for name in ("node_collisions", "pair_conflicts"):
        assert list(rows[name]) == [getattr(report, name) for report in reports]
    for name, rtol, atol in (
        ("fuel", 1e-6, 0),
        ("fuel_lower_bound", 1e-6, 0),
        ("min_separation", 0, 2e-3),
    ):
        found = [getattr(report, name) for report in reports]
        np.testing.assert_allclose(rows[name], found, rtol=rtol, atol=atol)
