"""Fuel against transfer time: certified plans for several durations of one scenario."""

from pipeline.tradeoff.curve import Goal, Point, arcs_between, knee, knee_of, tradeoff, with_arcs

__all__ = ["Goal", "Point", "arcs_between", "knee", "knee_of", "tradeoff", "with_arcs"]
