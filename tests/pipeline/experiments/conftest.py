"""Planted results."""

from planted import both, example, results, rows, trials, trials_at, warmstarts  # noqa: F401
