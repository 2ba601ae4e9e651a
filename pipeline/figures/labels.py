"""How numbers and planners are written in tables and figures."""

import math
from collections.abc import Iterable

from pipeline.text import visible

MISSING = "–"  # what stands for a number that does not exist
NEGLIGIBLE = 1e-6  # errors below this are rounding of the arithmetic, m


def number(value: float, spread: float = math.nan) -> str:
    """Text of a number with three significant digits, and of its spread unless that is NaN.

    From 100 on numbers are whole, below 0.001 they have powers of ten. The spread, a standard
    deviation, has the decimals of the value.

    >>> number(0.05), number(1.9064), number(12345.6), number(0.0000123)
    ('0.0500', '1.91', '12,346', '1.23e-5')
    >>> number(1.9, 0.0472)
    '1.90 ± 0.05'
    """
    if math.isnan(value):
        return MISSING
    size = abs(float(f"{value:.2e}"))
    if 1e-3 <= size < math.inf:
        return _fixed(value, spread, max(0, 2 - math.floor(math.log10(size))))
    if size in (0, math.inf):
        text = f"{value:.0f}".replace("inf", "∞")
    else:
        mantissa, exponent = f"{value:.2e}".split("e")
        text = f"{mantissa}e{int(exponent)}"
    return text if math.isnan(spread) else f"{text} ± {number(spread)}"


def ratio(value: float, spread: float = math.nan) -> str:
    """Text of a ratio, and of its spread, with three decimals around 1; elsewhere as ``number``."""
    return _fixed(value, spread, 3) if 0.1 <= value < 10 else number(value, spread)


def _fixed(value: float, spread: float, decimals: int) -> str:
    """Text of a value with a fixed number of decimals, and of its spread unless that is NaN."""
    text, least = f"{value:,.{decimals}f}", 10.0**-decimals
    if math.isnan(spread):
        return text
    if spread < least / 2:
        return f"{text} ± < {least:.{decimals}f}" if spread else f"{text} ± 0"
    return f"{text} ± {spread:,.{decimals}f}"


def count(value: float) -> str:
    """A whole number with thousands separated."""
    return MISSING if math.isnan(value) else f"{value:,.0f}"


def share(value: float, spread: float = math.nan) -> str:
    """Text of a share in percent, and of its spread; 0 % and 100 % only where they are exact.

    >>> share(0.44), share(0.44, 0.021), share(0.9999)
    ('44 %', '44.0 % ± 2.1 %', '> 99.9 %')
    """
    if math.isnan(value):
        return MISSING
    texts = [_percent(value)] if math.isnan(spread) else [_percent(value), _percent(spread)]
    if all(text.endswith(".0 %") for text in texts):
        texts = [text.replace(".0 %", " %") for text in texts]
    return " ± ".join(texts)


def _percent(share: float) -> str:
    percent = 100 * share
    if 0 < percent < 0.1 or 99.9 < percent < 100:
        return "< 0.1 %" if percent < 0.1 else "> 99.9 %"
    return f"{percent:.1f} %"


def percents(low: float, high: float) -> str:
    """Text of the confidence interval of a proportion, in percent."""
    return f"[{100 * low:.1f}, {100 * high:.1f}]"


def ratios(low: float, high: float) -> str:
    """Text of the confidence interval of a ratio."""
    return f"[{ratio(low)}, {ratio(high)}]"


def ratio_within(value: float, interval: tuple[float, float]) -> str:
    """Text of a ratio and its confidence interval; without the interval where it is NaN."""
    return ratio(value) if math.isnan(interval[0]) else f"{ratio(value)} {ratios(*interval)}"


def span(values: Iterable[float]) -> str:
    """Text of the least and the greatest of some numbers."""
    given = list(values)
    low, high = min(given), max(given)
    return number(low) if low == high else f"{number(low)} to {number(high)}"


def distinct_texts(values: Iterable[float], least: int) -> dict[float, str]:
    """Text of each number, with enough significant digits that all texts differ.

    >>> distinct_texts([60.0, 60.00001], 6)
    {60.0: '60', 60.00001: '60.00001'}
    """
    known, texts = set(values), dict[float, str]()
    for digits in range(least, 18):
        texts = {value: f"{value:.{digits}g}" for value in known}
        if len(set(texts.values())) == len(known):
            break
    return texts


def error(metres: float) -> str:
    """Text of an error in m; one that is mere rounding is ``< 1e-6``."""
    return "< 1e-6" if metres < NEGLIGIBLE else number(metres)


EXPERTS = {"expert": "Expert", "expert (nodes only)": "Expert (nodes only)"}
"""Centralized convex optimization: names in tables by the planner's name."""

BASELINES = {
    "straight line": "Straight line",
    "minimum energy": "Minimum energy",
    "decoupled optimum": "Decoupled optimum",
}
"""Planners that treat each craft without regard to the others."""

FEED_FORWARD = {"ff1": "FF1", "ff2": "FF2", "ffcol": "FFcol"}
RECURRENT = {"lstm1": "LSTM1", "lstm2": "LSTM2", "lstmcol": "LSTMcol"}  # the paper's, with those
REFINERS = {"refiner": "Refiner"}  # message passing between craft; not in the paper
KNOWN = EXPERTS | BASELINES | FEED_FORWARD | RECURRENT | REFINERS  # all of them, in reading order


def name_of(planner: str) -> str:
    """The name of a planner or a seed in tables and figures."""
    return "No seed" if planner == "none" else KNOWN.get(planner, visible(planner))


def planner_label(planner: str, recipe: str) -> str:
    """Label of a planner: its name, and the recipe that its network was trained by."""
    return f"{name_of(planner)} {recipe}".strip()


def planner_of(label: str) -> str:
    """The planner of a label with its recipe, such as the seed "ff1 tuned"."""
    return label.removesuffix(" tuned").removesuffix(" paper")


def label_name(label: str) -> str:
    """The name of such a label in tables and figures: "FF1 tuned"."""
    planner = planner_of(label)
    return name_of(planner) + label.removeprefix(planner)


def in_order(planners: Iterable[str]) -> list[str]:
    """Distinct planners: experts, baselines, feed-forward, LSTM, refiner, then others by name."""
    known = list(KNOWN)
    return sorted(set(planners), key=lambda p: (known.index(p) if p in known else len(known), p))


def is_network(planner: str) -> bool:
    """Whether a planner is neither an expert nor a baseline."""
    return planner not in EXPERTS | BASELINES


def name_in_sentence(planner: str) -> str:
    """The name of a planner within a sentence."""
    return f"the {planner}" if planner in EXPERTS | REFINERS else name_of(planner)


def architecture_of(planner: str) -> str:
    """The architecture of a network, also where that is named with its version ("ff1/3")."""
    return planner.partition("/")[0]


def is_of_paper(planner: str) -> bool:
    """Whether a planner is one of the paper's six networks, with or without a version."""
    return architecture_of(planner) in FEED_FORWARD | RECURRENT
