"""Decoupled optima of many craft, taken apart."""

from dataclasses import replace

from pipeline.networks.refiner.programs import Decoupled


def one_of(own: Decoupled, craft: int) -> Decoupled:
    """The decoupled optimum of one craft."""
    return replace(own, **{name: values[craft][None] for name, values in vars(own).items()})
