"""Fuel against transfer time: certified plans for several durations of one scenario."""

from pipeline.tradeoff.curve import Point, arcs_between, knee, tradeoff, with_arcs

__all__ = ["Point", "arcs_between", "knee", "tradeoff", "with_arcs"]
