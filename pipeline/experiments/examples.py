"""Example transfers as sections of the report (the paper's Figures 1 and 9)."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from pipeline.experiments.trials import Example
from pipeline.figures.tables import Picture, Section
from pipeline.figures.transfer import transfer_figure


def section(examples: Sequence[Example]) -> Section:
    """A figure for each example."""
    pictures = [
        (example.title, Picture(f"transfer-{k}", figure_of(example)))
        for k, example in enumerate(examples, start=1)
    ]
    return Section("pipeline/experiments/examples.md.jinja", {"pictures": pictures})


def figure_of(example: Example) -> Figure:
    """The figure of an example, a panel for each planner."""
    return transfer_figure(
        example.title, example.initial, example.goal, example.tracks, example.collision_radius
    )
