"""What others may have written into the store, as values; of no use where it is nonsense."""

import re
from datetime import UTC, datetime

_WHOLE = re.compile(r"-?[0-9]{1,15}")


def whole(text: str) -> int | None:
    """A whole number in ordinary digits, or None."""
    return int(text) if _WHOLE.fullmatch(text) else None


def moment(milliseconds: int | None) -> datetime:
    """A time of MLflow's as a date in UTC; the first of 1970 where it is none."""
    try:
        return datetime.fromtimestamp((milliseconds or 0) / 1000, UTC)
    except (ValueError, OverflowError, OSError, TypeError):
        return datetime.fromtimestamp(0, UTC)
