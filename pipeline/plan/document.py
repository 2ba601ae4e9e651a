"""plan.json (schema prolearn.plan/1): what a plan looks like outside of Python."""

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.files import write_text
from pipeline.orbit.problem import Problem
from pipeline.plan.plan import Plan

SCHEMA = "prolearn.plan/1"


def plan_document(plan: Plan, problem: Problem) -> dict[str, Any]:
    """The fields of a plan file; what is infinite or absent becomes null."""
    return {
        "schema": SCHEMA,
        "planner": plan.planner,
        "status": plan.status,
        "message": plan.message,
        "times": (np.arange(problem.nodes) * problem.time_step).tolist(),
        "states": plan.states.tolist(),
        "controls": plan.controls.tolist(),
        "certificate": {k: _plain(v) for k, v in asdict(plan.certificate).items()},
        "convex_solves": plan.convex_solves,
        "timing": dict(plan.timing),
    }


def write_plan(path: Path, plan: Plan, problem: Problem) -> None:
    """Write a plan file."""
    write_text(path, json.dumps(plan_document(plan, problem), allow_nan=False) + "\n")


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
