"""Scenarios: what a swarm is asked to do, the families they are drawn from, their file format."""

from pipeline.scenario.diagnostic import Diagnostic
from pipeline.scenario.families import FAMILIES, SPLITS, draw, draw_many
from pipeline.scenario.scenario import Scenario, participants, scenario_list, shared_problem
from pipeline.scenario.validation import check, diagnostics

__all__ = [
    "FAMILIES",
    "SPLITS",
    "Diagnostic",
    "Scenario",
    "check",
    "diagnostics",
    "draw",
    "draw_many",
    "participants",
    "scenario_list",
    "shared_problem",
]
