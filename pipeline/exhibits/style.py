"""One look for all figures: a colour, marker and line for each planner, fonts and sizes."""

import functools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar

import matplotlib
from matplotlib.figure import Figure
from matplotlib.text import Text

from pipeline.exhibits.planners import in_order
from pipeline.files import published
from pipeline.text import visible

P = ParamSpec("P")
R = TypeVar("R")

PAGE_WIDTH = 7.2
"""Width in inches of a figure across a page."""

INITIAL_COLOUR, GOAL_COLOUR, CONFLICT_COLOUR = "#0072B2", "#009E73", "#D55E00"
"""Blue, green and vermillion of the Okabe-Ito palette."""

GREY = "#4d4d4d"
"""Of axes, and of what belongs to no planner."""

RC: dict[Any, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": GREY,
    "axes.grid": True,
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 9,
    "figure.titlesize": 10,
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.5,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "lines.linewidth": 1.3,
    "lines.markersize": 4.5,
    "savefig.dpi": 200,
    "svg.fonttype": "path",
    "svg.hashsalt": "prolearn",
    "text.parse_math": False,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
}
"""Settings that every figure is drawn and saved with; the salt makes SVG ids repeatable."""


@dataclass(frozen=True)
class Style:
    """How a planner is drawn.

    Attributes:
        colour: hexadecimal colour.
        marker: matplotlib marker.
        line: matplotlib line style.
    """

    colour: str
    marker: str
    line: Literal["-", "--", "-.", ":"]

    @property
    def drawn(self) -> dict[str, Any]:
        """Matplotlib's arguments for it."""
        return {"color": self.colour, "marker": self.marker, "linestyle": self.line}


KNOWN = {
    "expert": Style("#000000", "o", "-"),
    "expert (nodes only)": Style("#777777", "H", "-."),
    "straight line": Style("#AAAAAA", "x", ":"),
    "minimum energy": Style("#997700", "+", ":"),
    "own LP": Style("#332288", "*", ":"),
    "ff1": Style("#56B4E9", "s", "-"),
    "ff2": Style("#0072B2", "^", "-"),
    "ffcol": Style("#009E73", "v", "-"),
    "lstm1": Style("#E69F00", "D", "--"),
    "lstm2": Style("#D55E00", "<", "--"),
    "lstmcol": Style("#CC79A7", ">", "--"),
    "refiner": Style("#AA0044", "P", "-"),
}
"""Okabe-Ito: cool and solid for feed-forward, warm and dashed for LSTM, dotted for baselines; the
refiner is crimson and solid."""

OTHER_COLOURS = ("#882255", "#117733", "#661100", "#6699CC", "#999933")
OTHER_MARKERS = ("X", "h", "p", "d")


def styles(planners: Iterable[str]) -> dict[str, Style]:
    """A style for each planner; planners unknown to the paper share out further ones by name."""
    others = [p for p in in_order(planners) if p not in KNOWN]
    further = {
        p: Style(OTHER_COLOURS[k % len(OTHER_COLOURS)], OTHER_MARKERS[k % len(OTHER_MARKERS)], "-.")
        for k, p in enumerate(others)
    }
    return KNOWN | further


def in_style(draw: Callable[P, R]) -> Callable[P, R]:
    """A drawing function run under ``RC``; the caller's matplotlib settings stay as they are."""

    @functools.wraps(draw)
    def styled(*args: P.args, **kwargs: P.kwargs) -> R:
        with matplotlib.rc_context(RC):
            return draw(*args, **kwargs)

    return styled


@in_style
def save(figure: Figure, path: Path, suffixes: Sequence[str] = (".svg", ".png")) -> None:
    """Write a figure as ``path`` with each suffix, the same bytes for the same figure.

    Of its texts, what cannot be seen is drawn as an escape.
    """
    for text in figure.findobj(Text):
        text.set_text(visible(text.get_text()))
    facts = {".svg": {"Date": None, "Creator": None}, ".png": {"Software": None}}
    for suffix in suffixes:
        metadata = facts[suffix]
        with published(path.with_name(path.name + suffix)) as temporary:
            figure.savefig(temporary, format=suffix[1:], metadata=metadata)
