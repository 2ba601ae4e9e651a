"""Who is shown beyond n = 30, and at which sizes."""

import pandas as pd

from pipeline.experiments.answer import FREE
from pipeline.experiments.networks import groups, of, spokesman
from pipeline.experiments.paper import LARGEST_SIZE
from pipeline.experiments.trials import PREDICTED

EXPERT, BASELINES = "expert", ("minimum energy", FREE)
"""Beside networks: the baseline that smooths most, and that which costs nothing."""


def shown_beyond(trials: pd.DataFrame, training: pd.DataFrame) -> pd.DataFrame:
    """Trials of the sizes above n = 30, and of the largest up to it, of what is shown there.

    That is the expert, BASELINES, and networks as they are flown: one for the paper's, by
    validation (all of them where that was not recorded), and every other.

    Args:
        trials: from ``prepared``.
        training: a row for each trained model.

    Returns:
        No rows where no size is above n = 30.
    """
    rows = trials[trials["reading"] != PREDICTED]
    sizes = rows["n"].astype(int)
    if not (sizes > LARGEST_SIZE).any():
        return rows.head(0)
    home = sizes[sizes <= LARGEST_SIZE].max()
    kept = [rows[rows["planner"].isin([EXPERT, *BASELINES])]]
    for group in groups(rows["planner"]):
        mine = group.of(rows)
        name = spokesman(mine, training)[0] if group.papers else None
        kept.append(mine if name is None else of(mine, name))
    shown = pd.concat(kept)
    return shown[(shown["n"] > LARGEST_SIZE) | (shown["n"] == home)]
