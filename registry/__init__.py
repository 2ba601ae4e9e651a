"""Runs, models and results in MLflow, which no other package imports; ProlearnError if it fails."""
