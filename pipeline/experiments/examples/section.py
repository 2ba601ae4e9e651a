"""The section on example transfers."""

from collections.abc import Sequence

from pipeline.exhibits.blocks import Picture
from pipeline.exhibits.sections import Section
from pipeline.experiments.examples.figure import figure_transfer
from pipeline.experiments.examples.run import Example


def section(examples: Sequence[Example]) -> Section:
    """A figure for each example."""
    pictures = [
        (example.title, Picture(f"transfer-{k}", figure_transfer(example)))
        for k, example in enumerate(examples, start=1)
    ]
    return Section("pipeline/experiments/examples/section.md.jinja", {"pictures": pictures})
