"""Draw the picture of README: its swarm when each craft flies its own optimum, and by the expert.

python docs/picture.py
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.arrays import Array
from pipeline.figures.style import CONFLICT_COLOUR, INITIAL_COLOUR, PAGE_WIDTH, in_style
from pipeline.orbit.problem import Problem
from pipeline.orbit.rings import pro_states
from pipeline.orbit.transfer import track
from pipeline.planners.classical import BASELINES, Expert
from pipeline.scenario import Scenario

OUT = Path(__file__).parent / "images" / "transfer.png"

STEPS = 24
"""Points drawn in each interval."""

OTHERS = "#b8b8b8"
"""Colour of the craft that nobody comes close to."""

Paths = Float[Array, "n k 3"]


def ring(size: float, tilt: float, first_phase: float) -> Float[Array, "3 6"]:
    """States of three equally spaced craft on a ring; size in m, angles in degrees."""
    phase = np.radians(first_phase + np.array([0.0, 120.0, 240.0]))
    return pro_states(size, float(np.radians(tilt)), phase, 0.0, Problem().mean_motion)


def swarm() -> Scenario:
    """The first swarm of README: two rings of three craft change places."""
    initial = np.concatenate([ring(150, 20, 0), ring(100, -20, 60)])
    goal = np.concatenate([ring(100, -20, 45), ring(150, 20, 60)])
    return Scenario(Problem(), initial, goal)


@in_style
def transfer_figure(scenario: Scenario) -> Figure:
    """Both plans seen along the orbit's normal, and how far the pair that meets is apart."""
    own, safe = (planner.plan([scenario])[0] for planner in (BASELINES[-1], Expert()))
    pair, time = own.certificate.min_separation_pair, own.certificate.min_separation_time
    assert pair is not None and time is not None
    paths = [track(p.states, p.controls, scenario.problem, STEPS) for p in (own, safe)]
    times = np.linspace(0, scenario.problem.duration, paths[0].shape[1])
    when = int(np.searchsorted(times, time))
    figure = Figure(figsize=(PAGE_WIDTH, 3.9), layout="constrained", facecolor="white")
    axes = figure.subplot_mosaic([["own", "apart"], ["safe", "apart"]], width_ratios=(1.25, 1))
    more = safe.certificate.fuel / own.certificate.fuel - 1
    titles = "Each craft by its own optimum", f"By the expert, for {100 * more:.1f} % more fuel"
    for name, title, shown in zip(("own", "safe"), titles, paths, strict=True):
        draw_paths(axes[name], shown, pair, when)
        axes[name].set_title(title)
        axes[name].set_ylabel("radial (m)")
    axes["own"].tick_params(labelbottom=False)
    axes["safe"].set_xlabel("along-track (m)")
    axes["safe"].legend(handles=axes["safe"].lines[:2], loc="center", ncols=2)
    draw_distances(axes["apart"], times / 60, paths, pair, scenario.problem.collision_radius)
    return figure


def draw_paths(ax: Axes, paths: Paths, pair: tuple[int, int], when: int) -> None:
    """Where craft go, with an arrow midway; of a pair, where it is at one moment."""
    for k, path in enumerate(paths):
        x, y = path[:, 1], path[:, 0]
        colour, above = (INITIAL_COLOUR, 3) if k in pair else (OTHERS, 2)
        ax.plot(x[0], y[0], "o", color=colour, fillstyle="none", zorder=above, label="start")
        ax.plot(x[-1], y[-1], "o", color=colour, zorder=above, label="goal")
        ax.plot(x, y, color=colour, zorder=above)
        middle = len(x) // 3
        ax.annotate(
            "",
            (x[middle + 3], y[middle + 3]),
            (x[middle], y[middle]),
            arrowprops={"arrowstyle": "-|>", "color": colour, "shrinkA": 0, "shrinkB": 0},
            zorder=above,
        )
    both = paths[list(pair), when]
    apart = float(np.linalg.norm(both[0] - both[1]))
    ax.plot(both[:, 1], both[:, 0], "o-", color=CONFLICT_COLOUR, zorder=4)
    ax.annotate(
        f"{apart:.0f} m apart",
        (float(both[:, 1].mean()), float(both[:, 0].mean())),
        xytext=(-66, -46),
        textcoords="offset points",
        color=CONFLICT_COLOUR,
        weight="bold",
        arrowprops={"arrowstyle": "-", "color": CONFLICT_COLOUR},
        zorder=5,
    )
    ax.set_aspect("equal")


def draw_distances(
    ax: Axes, minutes: Float[Array, "k"], paths: list[Paths], pair: tuple[int, int], radius: float
) -> None:
    """The distance of a pair against time by both plans, and the collision radius."""
    a, b = pair
    for shown, line, name in zip(paths, ("--", "-"), ("own optima", "expert"), strict=True):
        apart = np.linalg.norm(shown[a] - shown[b], axis=-1)
        ax.plot(minutes, apart, line, color=INITIAL_COLOUR, label=name)
    ax.axhspan(0, radius, color=CONFLICT_COLOUR, alpha=0.2, linewidth=0)
    ax.text(0.3, radius / 2, f"within {radius:g} m", color=CONFLICT_COLOUR, va="center")
    ax.set_xlim(0, minutes[-1])
    ax.set_ylim(0, 100)
    ax.set_title("Distance of the pair (m)")
    ax.set_xlabel("minutes")
    ax.legend(loc="upper center")


def main() -> None:
    """Write the picture."""
    OUT.parent.mkdir(exist_ok=True)
    transfer_figure(swarm()).savefig(OUT, dpi=200)


if __name__ == "__main__":
    main()
