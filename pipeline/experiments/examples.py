"""Example transfers in three dimensions (the paper's Figures 1 and 9)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pipeline.arrays import Array
from pipeline.experiments.trials import Example
from pipeline.figures import style
from pipeline.figures.labels import label_name
from pipeline.figures.tables import Picture, Section
from pipeline.orbit.approaches import pairs
from pipeline.orbit.rings import revolution


def section(examples: Sequence[Example]) -> Section:
    """A figure for each example."""
    pictures = [
        (example.title, Picture(f"transfer-{k}", figure_transfer(example)))
        for k, example in enumerate(examples, start=1)
    ]
    return Section("pipeline/experiments/examples.md.jinja", {"pictures": pictures})


COLUMNS = 3
ORBIT_POINTS = 121
ELEVATION, AZIMUTH = 26.0, -50.0
"""Where the viewer stands, deg."""

FILL = 1.03
"""Part of its square that matplotlib's 3-D axes give a box whose projection has unit size."""

MARGINS, MARGINS_LARGE = (0.75, 0.6), (1.35, 0.8)
"""Width and height around a projected box, for its numbers and labels, inches."""

TITLE, LEGEND = 0.3, 0.35
"""Heights above and below the panels, inches."""

TRACK: dict[str, Any] = {"color": "#333333", "linewidth": 0.7}
CONFLICT: dict[str, Any] = {"color": style.CONFLICT_COLOUR, "linewidth": 2.2}
ORBIT: dict[str, Any] = {"linewidth": 0.6, "alpha": 0.45}


@style.in_style
def figure_transfer(example: Example) -> Figure:
    """The tracks of each planner in its own panel, all at one equal scale, in the LVLH frame.

    Initial states are blue and goal states green, with the passive relative orbits through them;
    stretches where a pair is within the collision radius are vermillion.
    """
    ends = [
        (states, colour, _orbits(states))
        for states, colour in (
            (example.initial, style.INITIAL_COLOUR),
            (example.goal, style.GOAL_COLOUR),
        )
    ]
    low, high = _limits([*example.tracks.values(), *(orbits for *_, orbits in ends)])
    columns = max(1, min(COLUMNS, len(example.tracks)))
    rows = max(1, -(-len(example.tracks) // columns))
    width = (style.PAGE_WIDTH if columns > 1 else 0.75 * style.PAGE_WIDTH) / columns
    across, up = FILL * _projected(high - low)
    margins = MARGINS if columns > 1 else MARGINS_LARGE
    side = (width - margins[0]) / across
    height = side * up + margins[1]
    total = (columns * width, rows * height + TITLE + LEGEND)
    figure = Figure(figsize=total)
    for k, (label, path) in enumerate(example.tracks.items()):
        # Centres of the panel; the axes are square, so that they overlap where they are empty.
        x = (k % columns + 0.47) * width
        y = LEGEND + (rows - k // columns - 0.5) * height
        place = ((x - side / 2) / total[0], (y - side / 2) / total[1])
        size = (side / total[0], side / total[1])
        ax: Any = figure.add_axes((*place, *size), projection="3d", proj_type="ortho")
        _draw(ax, path, ends, within(path, example.collision_radius))
        _frame(ax, low, high, large=columns == 1)
        top = (y + height / 2 - 0.05) / total[1]
        figure.text(x / total[0], top, label_name(label), ha="center", va="top", fontsize=9)
    figure.suptitle(example.title, y=1 - 0.06 / total[1], va="top")
    handles = [
        Line2D([], [], color=style.INITIAL_COLOUR, linestyle="none", marker="o", label="initial"),
        Line2D([], [], color=style.GOAL_COLOUR, linestyle="none", marker="o", label="goal"),
        Line2D([], [], label="trajectory", **TRACK),
        Line2D([], [], label=f"pair within {example.collision_radius:g} m", **CONFLICT),
    ]
    figure.legend(handles=handles, loc="lower center", ncols=4)
    return figure


def _projected(box: Float[Array, "3"]) -> Float[Array, "2"]:
    """Width and height of a box in the viewer's plane, for a box of unit diagonal."""
    azimuth, elevation = np.radians(AZIMUTH), np.radians(ELEVATION)
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    ahead = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    upward = np.array([0.0, 0.0, np.cos(elevation)]) - np.sin(elevation) * ahead
    extent: Array = np.abs(np.stack([right, upward])) @ (box / np.linalg.norm(box))
    return extent


def within(track: Float[Array, "n K 3"], collision_radius: float) -> Bool[Array, "n K"]:
    """Which craft are within the collision radius of another, at each point of their tracks."""
    i, j = pairs(len(track))
    close = np.linalg.norm(track[i] - track[j], axis=-1) <= collision_radius
    involved = np.zeros(track.shape[:2], dtype=bool)
    np.logical_or.at(involved, i, close)
    np.logical_or.at(involved, j, close)
    return involved


def _orbits(states: Float[Array, "n 6"]) -> Float[Array, "n _ 3"]:
    """One revolution of free drift through each state; just the states where Eq. 3 fails."""
    found = revolution(states, ORBIT_POINTS)
    return states[:, None, :3] if found is None else found


def _draw(
    ax: Any,
    track: Float[Array, "n K 3"],
    ends: list[tuple[Array, str, Array]],
    conflicts: Bool[Array, "n K"],
) -> None:
    for states, colour, orbits in ends:
        ax.plot(*_strands(orbits), color=colour, **ORBIT)
        ax.plot(*states[:, :3].T, color=colour, linestyle="none", marker="o", markersize=3.2)
    ax.plot(*_strands(track), **TRACK)
    if conflicts.any():
        close = np.where(conflicts[..., None], track, np.nan)
        ax.plot(*_strands(close), marker=".", markersize=2.5, **CONFLICT)


def _strands(tracks: Float[Array, "n K 3"]) -> Float[Array, "3 _"]:
    """All tracks as one line, with a gap between them."""
    gap = np.full((len(tracks), 1, 3), np.nan)
    return np.concatenate([tracks, gap], axis=1).reshape(-1, 3).T


def _limits(tracks: list[Array]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Ranges that hold everything, none so flat that its axis has no room for numbers."""
    points = np.concatenate([t.reshape(-1, 3) for t in tracks])
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    middle, half = (low + high) / 2, 1.04 * (high - low) / 2
    half = np.maximum(half, max(0.25 * float(half.max()), 1.0))
    return middle - half, middle + half


def _frame(ax: Any, low: Float[Array, "3"], high: Float[Array, "3"], large: bool) -> None:
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set_box_aspect(high - low)
    ax.view_init(elev=ELEVATION, azim=AZIMUTH)
    ax.patch.set_visible(False)
    names = ("x, radial (m)", "y, along-track (m)", "z, cross-track (m)")
    for axis, name in zip((ax.xaxis, ax.yaxis, ax.zaxis), names, strict=True):
        axis.set_label_text(name if large else f"{name[0]} (m)", fontsize=8 if large else 6.5)
        axis.labelpad = -2 if large else -9
        axis.set_tick_params(labelsize=7 if large else 5.5, pad=-2 if large else -4)
        axis.get_major_locator().set_params(nbins=5 if large else 4)
        axis.set_pane_color((1, 1, 1, 0))
