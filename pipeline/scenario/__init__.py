"""Scenarios: what a swarm is asked to do, the families they are drawn from, their file format."""

from pipeline.scenario.families import FAMILIES, SPLITS, draw
from pipeline.scenario.scenario import Scenario, shared_problem
from pipeline.scenario.soundness import Finding, check, findings

__all__ = [
    "FAMILIES",
    "SPLITS",
    "Finding",
    "Scenario",
    "check",
    "draw",
    "findings",
    "shared_problem",
]
