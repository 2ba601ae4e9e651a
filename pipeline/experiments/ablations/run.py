"""Refiners that lack one thing, and the rule alone, on the same scenarios after other rounds."""

from collections.abc import Callable, Sequence

import pandas as pd

from pipeline.experiments.trials import Entrant, run_trials
from pipeline.progress import SILENT, Progress
from pipeline.scenario import Scenario

ROUNDS = ("family", "rounds", "own_rounds")
"""Columns beside those of Trial: the scenarios' family, rounds that were taken, and those that an
answer takes."""

EntrantsAfter = Callable[[int], Sequence[Entrant]]
"""Who takes part with a number of rounds."""


def run_ablations(
    entrants_after: EntrantsAfter,
    scenarios: Sequence[Scenario],
    rounds: Sequence[int],
    own: int,
    *,
    timed: int = 0,
    progress: Progress = SILENT,
) -> pd.DataFrame:
    """All entrants after every number of rounds.

    Args:
        entrants_after: who takes part with a number of rounds.
        scenarios: of one problem, one family and one n.
        rounds: how many are tried.
        own: those that the networks' answers take.
        timed: how many of the scenarios are planned once more one at a time, to take the time.
        progress: told of each entrant.

    Returns:
        A row a trial: ``ROUNDS`` and the columns of Trial.
    """
    tables = []
    for count in rounds:
        alone = min(timed, len(scenarios))
        table = run_trials(entrants_after(count), scenarios, timed=alone, progress=progress)
        table = table.assign(family=scenarios[0].family, rounds=count, own_rounds=own)
        tables.append(table[[*ROUNDS, *table.columns.drop(list(ROUNDS))]])
    return pd.concat(tables, ignore_index=True)
