"""What ± and brackets mean in a table."""

import pandas as pd

SAFE = ("safe_low", "safe_high")
"""Columns of the interval of the share of safe trials."""

INTERVALS = " Brackets are Wilson's 95 % intervals of a share."
"""What brackets mean, for captions."""


def spread_note(frame: pd.DataFrame) -> str:
    """What ± means, where a table has averages over several trainings (column ``seeds``)."""
    most = int(frame["seeds"].max())
    if most < 2:
        return ""
    return (
        f" Networks trained with several seeds (up to {most}) show the average of their trainings "
        "± the standard deviation between them."
    )
