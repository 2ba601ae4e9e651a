"""Draw the pictures of examples.md: each scenario file of examples/ as the expert plans it.

python docs/example_pictures.py
"""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator

from pipeline.arrays import Array
from pipeline.figures.style import GOAL_COLOUR, INITIAL_COLOUR, PAGE_WIDTH, in_style
from pipeline.orbit.transfer import track
from pipeline.planners.classical import Expert
from pipeline.scenario import Scenario
from pipeline.scenario.document import read_scenario

HERE = Path(__file__).parent
VIEWS = ((1, 0), (1, 2))  # axes across and up
NAMES = ("radial (m)", "along-track (m)", "cross-track (m)")
POINTS = 240  # drawn of each path, or one a node


@in_style
def picture(scenario: Scenario) -> Figure:
    """Paths in the orbit's plane and from outside it, from circles to dots."""
    plan = Expert().plan([scenario])[0]
    steps = max(1, POINTS // scenario.problem.intervals)
    paths = track(plan.states, plan.controls, scenario.problem, steps)
    flat = np.abs(paths[..., 2]).max() < 0.01 * np.abs(paths[..., 1]).max()
    figure = Figure(figsize=(PAGE_WIDTH, 2.9), layout="constrained", facecolor="white")
    views = VIEWS[:1] if flat else VIEWS
    for ax, (across, up) in zip(np.ravel(figure.subplots(1, len(views))), views, strict=True):
        draw(ax, paths[..., across], paths[..., up])
        for one in scenario.obstacles:
            size = one.semi_axes or (one.radius, one.radius, one.radius)
            axes = [2 * (size[k] or 0.0) for k in (across, up)]
            at = one.state[across], one.state[up]  # where it is at the first node
            ax.add_patch(Ellipse(at, *axes, facecolor="#d9d9d9", edgecolor="#707070"))
        ax.set_xlabel(NAMES[across])
        ax.set_ylabel(NAMES[up])
    return figure


def draw(ax: Axes, across: Array, up: Array) -> None:
    """Paths of all craft, (n, k) each way."""
    ax.plot(across.T, up.T, color="#b8b8b8", linewidth=0.7)
    ax.plot(across[:, 0], up[:, 0], "o", color=INITIAL_COLOUR, fillstyle="none", markersize=3.5)
    ax.plot(across[:, -1], up[:, -1], "o", color=GOAL_COLOUR, markersize=2.5)
    ax.xaxis.set_major_locator(MaxNLocator(6))


def main() -> None:
    """Write the pictures."""
    for file in sorted((HERE.parent / "examples").glob("*.json")):
        picture(read_scenario(file)).savefig(HERE / f"images/example-{file.stem}.png", dpi=100)


if __name__ == "__main__":
    main()
