"""The rule of every verdict: yes, no or open, by the 95 % interval of what was measured.

A claim about a threshold holds where the whole interval meets it, fails where the whole interval
misses it, and is open (None) where the threshold lies within.
"""

from collections.abc import Iterable

from pipeline.exhibits.intervals import Interval


def at_least(interval: Interval, threshold: float) -> bool | None:
    """Whether a number is at least so large; open, too, where there is no interval."""
    low, high = interval
    return True if low >= threshold else False if high < threshold else None


def at_most(interval: Interval, threshold: float) -> bool | None:
    """Whether a number is at most so large; open, too, where there is no interval."""
    low, high = interval
    return True if high <= threshold else False if low > threshold else None


def all_hold(claims: Iterable[bool | None]) -> bool | None:
    """Whether all of some claims hold; open where there are none."""
    found = list(claims)
    return False if False in found else None if None in found or not found else True
