"""Fuel against transfer time."""
