"""The trained refiner that comes with the package, so that it plans right after installation."""

from functools import lru_cache
from pathlib import Path

from pipeline.networks.model import Model, load

FOLDER = Path(__file__).parent / "default"
"""Weights, description and model card."""


@lru_cache(maxsize=1)
def packaged() -> Model:
    """The packaged model; it plans for any number of craft, on any orbit and time grid."""
    return load(FOLDER)
