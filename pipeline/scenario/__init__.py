"""Scenarios: what a swarm is asked to do, the families they are drawn from, their file format."""

from pipeline.scenario.families import FAMILIES, SPLITS, draw
from pipeline.scenario.scenario import Scenario, check

__all__ = ["FAMILIES", "SPLITS", "Scenario", "check", "draw"]
