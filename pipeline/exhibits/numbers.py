"""Numbers as a reader wants them: three significant digits, and no false zeros or hundreds."""

import math

MISSING = "–"
"""What stands for a number that does not exist."""

NEGLIGIBLE = 1e-6
"""Errors in m below this are rounding of the arithmetic."""


def number(value: float) -> str:
    """Three significant digits; whole numbers from 100 on, powers of ten below 0.001.

    >>> number(0.05), number(1.9064), number(12345.6), number(0.0000123)
    ('0.0500', '1.91', '12,346', '1.23e-5')
    """
    if math.isnan(value):
        return MISSING
    if value == 0 or math.isinf(value):
        return f"{value:.0f}".replace("inf", "∞")
    size = abs(float(f"{value:.2e}"))
    if size >= 100:
        return f"{value:,.0f}"
    if size >= 1e-3:
        return f"{value:#.3g}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def ratio(value: float) -> str:
    """Four significant digits around 1, where the third decimal counts; else as ``number``."""
    return f"{value:.3f}" if 0.1 <= value < 10 else number(value)


def count(value: float) -> str:
    """A whole number with thousands separated."""
    return MISSING if math.isnan(value) else f"{value:,.0f}"


def share(value: float) -> str:
    """A share in percent that reads 0 % or 100 % only where it is exactly that."""
    if math.isnan(value):
        return MISSING
    if value in (0.0, 1.0):
        return f"{100 * value:.0f} %"
    percent = 100 * value
    if percent < 0.1 or percent > 99.9:
        return "< 0.1 %" if percent < 0.1 else "> 99.9 %"
    return f"{percent:.1f}".removesuffix(".0") + " %"


def percents(low: float, high: float) -> str:
    """The interval of a share, in percent."""
    return f"[{100 * low:.1f}, {100 * high:.1f}]"


def ratios(low: float, high: float) -> str:
    """The interval of a ratio."""
    return f"[{ratio(low)}, {ratio(high)}]"


def error(metres: float) -> str:
    """An error in m; what is rounding of the arithmetic shows as such."""
    return "< 1e-6" if metres < NEGLIGIBLE else number(metres)
