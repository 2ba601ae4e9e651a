"""Own optima of many craft, taken apart."""

from dataclasses import replace

from pipeline.networks.refiner.program import Own


def one_of(own: Own, craft: int) -> Own:
    """The own optimum of one craft."""
    return replace(own, **{name: values[craft][None] for name, values in vars(own).items()})
