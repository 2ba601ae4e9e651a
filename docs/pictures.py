"""Draw README's picture, and those of examples.md: each scenario of examples/ by the expert.

python docs/pictures.py
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator

import prolearn
from pipeline.arrays import Array
from pipeline.figures import style
from pipeline.orbit.transfer import track
from pipeline.planners.classical import BASELINES, Expert
from pipeline.show.data import obstacles_at
from prolearn import Ring, Scenario

HERE = Path(__file__).parent
STEPS = 24  # points drawn in each interval of README's swarm
OTHERS = "#b8b8b8"  # colour of the craft that nobody comes close to
VIEWS = ((1, 0), (1, 2))  # of examples: axes across and up
NAMES = ("radial (m)", "along-track (m)", "cross-track (m)")
LONGEST = 8.0  # length over height of flat paths up to which both axes have one scale
EXAMPLE_POINTS = 240  # drawn of each path of an example, or one a node

Paths = Float[Array, "n k 3"]


def swarm() -> Scenario:
    """The first swarm of README: two rings of three craft change places."""
    large, small = Ring(craft=3, size=150, tilt_deg=20), Ring(craft=3, size=100, tilt_deg=-20)
    return prolearn.scenario(
        initial=[large, small | {"first_phase_deg": 60}],
        goal=[small | {"first_phase_deg": 45}, large | {"first_phase_deg": 60}],
    )


@style.in_style
def transfer_figure(scenario: Scenario) -> Figure:
    """Both plans seen along the orbit's normal, and how far the pair that meets is apart."""
    own, safe = (planner.plan([scenario])[0] for planner in (BASELINES[-1], Expert()))
    pair, time = own.certificate.min_separation_pair, own.certificate.min_separation_time
    assert pair is not None and time is not None
    paths = [track(p.states, p.controls, scenario.problem, STEPS) for p in (own, safe)]
    times = np.linspace(0, scenario.problem.duration, paths[0].shape[1])
    when = int(np.searchsorted(times, time))
    figure = Figure(figsize=(style.PAGE_WIDTH, 3.9), layout="constrained", facecolor="white")
    axes = figure.subplot_mosaic([["own", "apart"], ["safe", "apart"]], width_ratios=(1.25, 1))
    more = safe.certificate.fuel / own.certificate.fuel - 1
    titles = "Decoupled optima", f"By the expert, for {100 * more:.1f} % more fuel"
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
        colour, above = (style.INITIAL_COLOUR, 3) if k in pair else (OTHERS, 2)
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
    ax.plot(both[:, 1], both[:, 0], "o-", color=style.CONFLICT_COLOUR, zorder=4)
    ax.annotate(
        f"{apart:.0f} m apart",
        (float(both[:, 1].mean()), float(both[:, 0].mean())),
        xytext=(-66, -46),
        textcoords="offset points",
        color=style.CONFLICT_COLOUR,
        weight="bold",
        arrowprops={"arrowstyle": "-", "color": style.CONFLICT_COLOUR},
        zorder=5,
    )
    ax.set_aspect("equal")


def draw_distances(
    ax: Axes, minutes: Float[Array, "k"], paths: list[Paths], pair: tuple[int, int], radius: float
) -> None:
    """The distance of a pair against time by both plans, and the collision radius."""
    a, b = pair
    for shown, line, name in zip(paths, ("--", "-"), ("decoupled optima", "expert"), strict=True):
        apart = np.linalg.norm(shown[a] - shown[b], axis=-1)
        ax.plot(minutes, apart, line, color=style.INITIAL_COLOUR, label=name)
    ax.axhspan(0, radius, color=style.CONFLICT_COLOUR, alpha=0.2, linewidth=0)
    ax.text(0.3, radius / 2, f"within {radius:g} m", color=style.CONFLICT_COLOUR, va="center")
    ax.set_xlim(0, minutes[-1])
    ax.set_ylim(0, 100)
    ax.set_title("Distance of the pair (m)")
    ax.set_xlabel("minutes")
    ax.legend(loc="upper center")


@style.in_style
def example_figure(scenario: Scenario) -> Figure:
    """Paths in the orbit's plane and from outside it, from circles to dots."""
    plan = Expert().plan([scenario])[0]
    steps = max(1, EXAMPLE_POINTS // scenario.problem.intervals)
    paths = track(plan.states, plan.controls, scenario.problem, steps)
    drifts = obstacles_at(np.linspace(0, scenario.problem.duration, EXAMPLE_POINTS + 1), scenario)
    flat = np.abs(paths[..., 2]).max() < 0.01 * np.abs(paths[..., 1]).max()
    figure = Figure(figsize=(style.PAGE_WIDTH, 2.9), layout="constrained", facecolor="white")
    views = VIEWS[:1] if flat else VIEWS
    for ax, (across, up) in zip(np.ravel(figure.subplots(1, len(views))), views, strict=True):
        x, y = paths[..., across].T, paths[..., up].T
        ax.plot(x, y, color=OTHERS, linewidth=0.7)
        ax.plot(x[0], y[0], "o", color=style.INITIAL_COLOUR, fillstyle="none", markersize=3.5)
        ax.plot(x[-1], y[-1], "o", color=style.GOAL_COLOUR, markersize=2.5)
        ax.xaxis.set_major_locator(MaxNLocator(6))
        for one, drift in zip(scenario.obstacles, drifts, strict=True):
            ax.plot(drift[:, across], drift[:, up], color="#707070", linewidth=0.7, linestyle="--")
            size = one.semi_axes or (one.radius, one.radius, one.radius)
            axes = [2 * (size[k] or 0.0) for k in (across, up)]
            at = one.state[across], one.state[up]  # where it is at the first node
            ax.add_patch(Ellipse(at, *axes, facecolor="#d9d9d9", edgecolor="#707070"))
        ax.set_xlabel(NAMES[across])
        ax.set_ylabel(NAMES[up])
        if flat and np.ptp(paths[..., across]) < LONGEST * np.ptp(paths[..., up]):
            ax.set_aspect("equal", adjustable="datalim")
    return figure


def main() -> None:
    """Write the pictures."""
    images = HERE / "images"
    transfer_figure(swarm()).savefig(images / "transfer.png", dpi=200)
    for file in sorted((HERE.parent / "examples").glob("*.json")):
        scenario = prolearn.read_scenario(file)
        example_figure(scenario).savefig(images / f"example-{file.stem}.png", dpi=100)


if __name__ == "__main__":
    main()
