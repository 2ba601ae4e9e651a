"""Whether networks serve other transfer times, answered by the numbers of experiment 4."""

import pandas as pd

from pipeline.exhibits.numbers import ratio, share
from pipeline.experiments.answer import FREE, Answer, measured
from pipeline.experiments.experiment4.run import NODES, TIME_STEP
from pipeline.experiments.experiment4.summary import TimeGrid, of_way, trained_on, with_minutes
from pipeline.experiments.networks import YES, Group, groups, names_in, of, spokesman, verdict
from pipeline.experiments.summary import prepared
from pipeline.experiments.trials import PREDICTED

OPEN = "Open: too few trials"

Row = tuple[float, pd.DataFrame]
"""A transfer time in minutes, and one planner's trials there."""


def times_answers(times: pd.DataFrame, training: pd.DataFrame) -> list[Answer]:
    """A row for each way to another transfer time and each group of networks that have one for it.

    That is one that took part at all of them.

    It serves a transfer time where it is safe and cheap, by the rule of every verdict.

    Args:
        times: a row for each trial at each transfer time.
        training: a row for each trained model.
    """
    if times.empty:
        return []
    trials = prepared(with_minutes(times[times["reading"] != PREDICTED]))
    found = []
    for way, called in ((NODES, "nodes T"), (TIME_STEP, "time steps Δt")):
        rows = of_way(trials, way).drop_duplicates(
            ["planner", "recipe", "training_seed", "trial", "minutes"]
        )
        for group in groups(rows["planner"]):
            answer = _answer(rows, group, trained_on(times), training, called)
            found += [answer] if answer else []
    return found


def _answer(
    rows: pd.DataFrame, group: Group, trained: TimeGrid, training: pd.DataFrame, called: str
) -> Answer | None:
    everywhere = rows["minutes"].nunique()
    networks = group.of(rows)
    fits = networks.groupby(["planner", "recipe"])["minutes"].transform("nunique") == everywhere
    name, how = spokesman(networks[fits], training)
    if name is None or everywhere < 2:
        return None
    mine, free = _by_time(of(networks, name)), _by_time(rows[rows["planner"] == FREE])
    home = [k for k, (minutes, _) in enumerate(mine) if minutes == trained.minutes]
    if not home:
        return None
    there = measured(mine[home[0]][1])
    alone = ", the only one that fits" if len(names_in(networks)) > 1 else ""
    how = f"{how} of those that fit" if how else alone
    asked = f"trained for {trained.minutes:g} min serve other {called}?"
    return Answer(
        group.asked(f"Does a network of the paper's {asked}", f"Does {{}} {asked}"),
        _served(mine, home[0]),
        f"{there.name}{how}: at {trained.minutes:g} min {there.text}; {_worst(mine)}",
        f"Own LP: {_worst(free)}" if free else "",
    )


def _by_time(rows: pd.DataFrame) -> list[Row]:
    return [(float(str(minutes)), part) for minutes, part in rows.groupby("minutes")]


def _worst(mine: list[Row]) -> str:
    """The worst of one planner over its transfer times."""
    numbers = [(minutes, measured(rows)) for minutes, rows in mine]
    least = min(numbers, key=lambda row: row[1].safe)
    dearest = max(numbers, key=lambda row: row[1].fuel)
    return (
        f"at worst safe in {share(least[1].safe)} ({least[0]:.3g} min) and "
        f"{ratio(dearest[1].fuel)} of the bound ({dearest[0]:.3g} min)"
    )


def _served(mine: list[Row], home: int) -> str:
    """The transfer times around the training's, without a gap, that the planner serves."""
    said = [verdict([measured(rows)]) for _, rows in mine]
    if said[home] != YES:
        return OPEN if said[home].startswith("Open") else f"No, not even {mine[home][0]:g} min"
    first = last = home
    while first > 0 and said[first - 1] == YES:
        first -= 1
    while last < len(mine) - 1 and said[last + 1] == YES:
        last += 1
    around = said[max(first - 1, 0) : first] + said[last + 1 : last + 2]
    if not around:
        return "Yes, at every time tried"
    known = all(one.startswith("No") for one in around)
    if first == last:
        return "No, at no other time tried" if known else OPEN
    served = f"{mine[first][0]:.3g} to {mine[last][0]:.3g} min"
    return f"Only from {served}" if known else f"From {served}; else open: too few trials"
