"""A transfer in three dimensions, as several planners fly it (the paper's Figures 1 and 9)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.arrays import Array, Bool, Float
from pipeline.figures import style
from pipeline.figures.labels import label_name
from pipeline.orbit.partition import pairs
from pipeline.orbit.rings import revolution

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = 3
ORBIT_POINTS = 121
ELEVATION, AZIMUTH = 26.0, -50.0  # where the viewer stands, deg
ZOOM = 1.02  # of a small panel, in which the box of the axes and its labels just fit

TRACK: dict[str, Any] = {"color": "#333333", "linewidth": 0.7}
CONFLICT: dict[str, Any] = {"color": style.CONFLICT_COLOUR, "linewidth": 2.2}
ORBIT: dict[str, Any] = {"linewidth": 0.6, "alpha": 0.45}


@dataclass(frozen=True, eq=False)
class Example:
    """One transfer as several planners fly it, in the LVLH frame."""

    title: str
    initial: Float[Array, "n 6"]  # m and m/s
    goal: Float[Array, "n 6"]
    tracks: Mapping[str, Float[Array, "n _ 3"]]  # positions dense in time, m, by planner's label
    collision_radius: float  # m


@style.in_style
def transfer_figure(example: Example) -> "Figure":
    """The tracks of an example, a panel for each planner, all at one equal scale.

    Initial states are blue and goal states green, with the passive relative orbits through them;
    stretches where a pair is within the collision radius are vermillion.
    """
    # Slow to import, and only figures need them
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    tracks, colours = example.tracks, {"initial": style.INITIAL_COLOUR, "goal": style.GOAL_COLOUR}
    ends = zip((example.initial, example.goal), colours.values(), strict=True)
    drawn = [(states, colour, _orbits(states)) for states, colour in ends]
    low, high = _limits([*tracks.values(), *(orbits for *_, orbits in drawn)])
    columns = max(1, min(COLUMNS, len(tracks)))
    rows = max(1, -(-len(tracks) // columns))
    large, width = columns == 1, style.PAGE_WIDTH if columns > 1 else 0.75 * style.PAGE_WIDTH
    figure = Figure(figsize=(width, 0.7 + rows * 0.8 * width / columns))
    projection = {"projection": "3d", "proj_type": "ortho"}
    axes: Any = figure.subplots(rows, columns, squeeze=False, subplot_kw=projection)
    figure.subplots_adjust(left=0.01, right=0.95, bottom=0.04, top=0.95, wspace=0.0, hspace=0.0)
    for ax in axes.flat[len(tracks) :]:
        ax.remove()
    for ax, (label, path) in zip(axes.flat, tracks.items(), strict=False):
        for states, colour, orbits in drawn:
            ax.plot(*_strands(orbits), color=colour, **ORBIT)
            ax.plot(*states[:, :3].T, color=colour, linestyle="none", marker="o", markersize=3.2)
        ax.plot(*_strands(path), **TRACK)
        close = within(path, example.collision_radius)
        if close.any():
            conflicts = np.where(close[..., None], path, np.nan)
            ax.plot(*_strands(conflicts), marker=".", markersize=2.5, **CONFLICT)
        _frame(ax, low, high, large)
        ax.set_title(label_name(label), loc="center", y=0.92)
    figure.suptitle(example.title)
    handles = [
        Line2D([], [], color=colour, linestyle="none", marker="o", label=end)
        for end, colour in colours.items()
    ]
    handles.append(Line2D([], [], label="trajectory", **TRACK))
    label = f"pair within {example.collision_radius:g} m"
    handles.append(Line2D([], [], label=label, **CONFLICT))
    figure.legend(handles=handles, loc="lower center", ncols=4)
    return figure


def within(track: Float[Array, "n K 3"], collision_radius: float) -> Bool[Array, "n K"]:
    """Which craft are within the collision radius of another, at each point of their tracks."""
    i, j = pairs(len(track))
    close = np.linalg.norm(track[i] - track[j], axis=-1) <= collision_radius
    involved = np.zeros(track.shape[:2], dtype=bool)
    np.logical_or.at(involved, i, close)
    np.logical_or.at(involved, j, close)
    return involved


def _orbits(states: Float[Array, "n 6"]) -> Float[Array, "n _ 3"]:
    """One revolution of free drift through each state; just the states if they violate Eq. 3."""
    found = revolution(states, ORBIT_POINTS)
    return states[:, None, :3] if found is None else found


def _strands(tracks: Float[Array, "n K 3"]) -> Float[Array, "3 _"]:
    """All tracks as one line, with a gap between them."""
    gap = np.full((len(tracks), 1, 3), np.nan)
    return np.concatenate([tracks, gap], axis=1).reshape(-1, 3).T


def _limits(tracks: list[Array]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Axis limits around all points, none so narrow that its axis has no room for numbers."""
    points = np.concatenate([t.reshape(-1, 3) for t in tracks])
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    middle, half = (low + high) / 2, 1.04 * (high - low) / 2
    half = np.maximum(half, max(0.25 * float(half.max()), 1.0))
    return middle - half, middle + half


def _frame(ax: Any, low: Float[Array, "3"], high: Float[Array, "3"], large: bool) -> None:
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set_box_aspect(high - low, zoom=0.85 if large else ZOOM)
    ax.view_init(elev=ELEVATION, azim=AZIMUTH)
    ax.patch.set_visible(False)
    names = ("x, radial (m)", "y, along-track (m)", "z, cross-track (m)")
    for axis, name in zip((ax.xaxis, ax.yaxis, ax.zaxis), names, strict=True):
        axis.set_label_text(name if large else f"{name[0]} (m)", fontsize=8 if large else 6.5)
        axis.labelpad = -2 if large else -9
        axis.set_tick_params(labelsize=7 if large else 5.5, pad=-2 if large else -4)
        axis.get_major_locator().set_params(nbins=5 if large else 4)
        axis.set_pane_color((1, 1, 1, 0))
