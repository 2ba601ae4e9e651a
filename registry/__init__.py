"""Runs, models and results in MLflow, which no other package imports; ProlearnError if it fails."""

from pathlib import Path

from pipeline.errors import InputError

try:
    Path.home()
except RuntimeError as error:  # as MLflow ends when it is imported
    raise InputError("there is no home folder; expected HOME to name one: set it.") from error
