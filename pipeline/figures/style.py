"""The style of all figures: planners' colours and markers, fonts, axes; and writing to files."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.figures.labels import in_order
from pipeline.files import published
from pipeline.text import visible

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAGE_WIDTH = 7.2  # width of a figure across a page, inches

INITIAL_COLOUR, GOAL_COLOUR, CONFLICT_COLOUR = "#0072B2", "#009E73", "#D55E00"
"""Blue, green and vermillion of the Okabe-Ito palette."""

GREY = "#4d4d4d"  # colour of axes, and of what belongs to no planner

REFERENCE: dict[str, Any] = {"color": GREY, "linewidth": 0.8, "linestyle": (0, (4, 3))}
"""Matplotlib's arguments of a line at a reference value."""

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
    "svg.hashsalt": "prolearn",  # makes the ids in SVG files repeatable
    "text.parse_math": False,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
}
"""Settings that every figure is drawn and saved with."""


@dataclass(frozen=True)
class Style:
    """How a planner is drawn, in matplotlib's terms."""

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
    "decoupled optimum": Style("#332288", "*", ":"),
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


def planner_styles(planners: Iterable[str]) -> dict[str, Style]:
    """A style for each planner; those not in KNOWN get further ones in order of their names."""
    others = [p for p in in_order(planners) if p not in KNOWN]
    looks = zip(others, cycle(OTHER_COLOURS), cycle(OTHER_MARKERS), strict=False)
    return KNOWN | {planner: Style(colour, marker, "-.") for planner, colour, marker in looks}


_DRAWING = RLock()


@contextmanager
def _styled() -> Iterator[None]:
    from matplotlib.style import context  # slow to import, and only figures need it

    with _DRAWING, context(["default", RC]):  # matplotlib's settings are shared by all threads
        yield


in_style = _styled()
"""Decorator of functions that draw; the caller's matplotlib settings stay as they are."""


def make_visible(figure: "Figure") -> None:
    """Replace what cannot be drawn or seen in a figure's texts, as names from files, by escapes."""
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        text.set_text(visible(text.get_text()))


@in_style
def save(figure: "Figure", path: Path, suffixes: Sequence[str] = (".svg", ".png")) -> None:
    """Write a figure as ``path`` with each suffix, laid out once; same figure, same bytes."""
    make_visible(figure)
    # Laid out here, since ``savefig`` would draw it once more for that.
    figure.set_dpi(RC["savefig.dpi"])
    if (engine := figure.get_layout_engine()) is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)
    facts = {".svg": {"Date": None, "Creator": None}, ".png": {"Software": None}}
    for suffix in suffixes:
        with published(path.with_name(path.name + suffix)) as temporary:
            figure.savefig(temporary, format=suffix[1:], metadata=facts[suffix])


SPREAD = 20.0  # largest over smallest positive value from which a scale is logarithmic
FINEST = 1e-3  # averages below this are shown on the linear part of a symmetric log scale
CROWDED = 1.7  # decades from which only powers of ten are labelled
NARROW = 0.5  # decades below which 1, 2 and 5 might label a log scale once only

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
"""Superscript digits; figures do not parse formulas, so that no name is taken for one."""


def fit_scale(
    ax: "Axes", side: Literal["x", "y"], values: Iterable[float], log: bool = False
) -> None:
    """Scale one axis for all values shown on it, none negative: linear, log, or symlog for zeros.

    Axes that share it follow. With ``log`` positive values over half a decade are logarithmic, too.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    array = np.asarray([v for v in values if np.isfinite(v)], dtype=float)
    positive = array[array > 0]
    zeros = bool((array == 0).any())
    spread = 10.0**NARROW if log and not zeros else SPREAD
    wide = positive.size > 0 and positive.max() / spread > positive.min()
    axis: Any = ax.xaxis if side == "x" else ax.yaxis
    limits = ax.set_xlim if side == "x" else ax.set_ylim
    scale = ax.set_xscale if side == "x" else ax.set_yscale
    if not wide:
        if zeros:  # none of the numbers is negative
            most = array.max() if positive.size else 1.0
            limits(-0.05 * most, None if positive.size else most)
        return
    low, high = float(positive.min()), float(positive.max())
    if zeros:
        threshold = float(max(FINEST, 10.0 ** np.floor(np.log10(low))))
        scale("symlog", linthresh=threshold, linscale=0.5)
        limits(-0.25 * threshold, 1.6 * high)
    else:
        scale("log")
        limits(low / 1.35, high * 1.35)
        few = np.log10(high / low) < CROWDED
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
    axis.set_major_formatter(FuncFormatter(_decimal))
    axis.set_minor_formatter(NullFormatter())


def _decimal(value: float, _position: object) -> str:
    """Plain decimals where they are short; elsewhere 10⁻⁴ or 5·10⁻⁴."""
    if value == 0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:g}"
    if value < 0:
        return ""
    mantissa, exponent = f"{value:.2e}".split("e")
    factor = f"{float(mantissa):g}·" * (float(mantissa) != 1)
    return f"{factor}10{str(int(exponent)).translate(RAISED)}"
