"""Axes that suit what spans decades, with and without zeros, numbered in plain decimals."""

from collections.abc import Iterable
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

SPREAD = 20.0
"""Values whose largest exceeds the smallest positive one by this factor get a log scale."""

FINEST = 1e-3
"""Averages below this are shown on the linear part of a symmetric log scale."""

CROWDED = 1.7
"""Decades from which only powers of ten carry a number."""

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
"""Digits of exponents; figures have no formulas, which names would be taken for."""


def fit_scale(
    ax: Axes, side: Literal["x", "y"], values: Iterable[float], log: bool = False
) -> None:
    """Scale one axis for values that are not negative: linear, log, or symlog where some are 0.

    Args:
        ax: the axes; those that share the axis follow.
        side: which axis.
        values: all that is shown on it.
        log: whether a narrow range of positive values is logarithmic too.
    """
    array = np.asarray([v for v in values if np.isfinite(v)], dtype=float)
    positive = array[array > 0]
    zeros = bool((array == 0).any())
    wide = positive.size > 0 and positive.max() > SPREAD * positive.min()
    axis: Any = ax.xaxis if side == "x" else ax.yaxis
    limits = ax.set_xlim if side == "x" else ax.set_ylim
    scale = ax.set_xscale if side == "x" else ax.set_yscale
    if positive.size == 0 or not (wide or (log and not zeros)):
        if zeros:
            limits(-0.05 * array.max() if array.max() > 0 else -0.05)
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
    """Plain decimals where they are short; powers of ten elsewhere."""
    if value == 0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:g}"
    return "10" + str(round(np.log10(value))).translate(RAISED) if value > 0 else ""
