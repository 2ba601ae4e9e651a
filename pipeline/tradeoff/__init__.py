"""Fuel against transfer time: certified plans for several durations of one scenario."""

from pipeline.tradeoff.curve import Point, arcs_between, tradeoff, with_arcs
from pipeline.tradeoff.knee import knee

__all__ = ["Point", "arcs_between", "knee", "tradeoff", "with_arcs"]
