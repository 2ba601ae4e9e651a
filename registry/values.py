"""What anyone may have written into a shared store, as values, and where it is nonsense."""

import logging
import re
from datetime import UTC, datetime

from pipeline.text import visible
from pipeline.urls import public

SHOWN = 40
"""Characters of nonsense that a sentence quotes."""

MOST = 1e15
"""Greatest number that anything counts to."""

_WHOLE = re.compile(r"-?[0-9]{1,15}")


def whole(text: str) -> int | None:
    """A whole number in ordinary digits, or None."""
    return int(text) if _WHOLE.fullmatch(text) else None


def whole_metric(value: float | None) -> int | None:
    """A metric that counts something, or None."""
    return None if value is None or not abs(value) < MOST else int(value)


def moment(milliseconds: int | None) -> datetime:
    """A time of MLflow's as a date in UTC; the first of 1970 where it is none."""
    try:
        return datetime.fromtimestamp((milliseconds or 0) / 1000, UTC)
    except (ValueError, OverflowError, OSError):
        return datetime.fromtimestamp(0, UTC)


def warn(sentence: str) -> None:
    """Say on stderr what of a store is left out, and why."""
    logging.getLogger("prolearn").warning("%s", visible(public(sentence)))
