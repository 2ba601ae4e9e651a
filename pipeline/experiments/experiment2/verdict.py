"""The verdicts of experiment 2: on one network in the largest swarm, and on the two families."""

import pandas as pd

from pipeline.exhibits.numbers import number
from pipeline.exhibits.planners import FEED_FORWARD, RECURRENT, name_of
from pipeline.experiments import paper
from pipeline.experiments.answer import FREE, Answer
from pipeline.experiments.networks import flown_networks, network_answers
from pipeline.experiments.summary import COLLISIONS, sizes_of_paper
from pipeline.experiments.trials import FLOWN, PREDICTED

QUESTION = "Do feed-forward networks collide less than LSTMs in larger swarms, as in the paper?"


def others_answer(trials: pd.DataFrame, training: pd.DataFrame, n: int) -> list[Answer]:
    """A row for each group of networks on the largest swarm that any were flown in, up to n = 30.

    There is none where that is the swarm of size n.

    Args:
        trials: from ``prepared``.
        training: a row for each trained model.
        n: the swarm size of experiment 1.
    """
    trials = sizes_of_paper(trials)
    largest = max(map(int, flown_networks(trials)["n"]), default=n)
    asked = f"trained at n = {paper.NETWORK_SIZE} serve others (n = {largest})?"
    questions = f"Does a network of the paper's {asked}", f"Does {{}} {asked}"
    return [] if largest == n else network_answers(questions, trials, training, largest)


def families_answer(summary: pd.DataFrame) -> list[Answer]:
    """A row, where both families took part in one recipe; the paper's own setting first."""
    summary = sizes_of_paper(summary)
    networks = summary[summary["planner"].isin(FEED_FORWARD | RECURRENT)]
    for recipe in ("paper", "tuned", ""):
        for reading in (PREDICTED, FLOWN):
            rows = networks[(networks["recipe"] == recipe) & (networks["reading"] == reading)]
            rows = rows[rows["n"] == rows["n"].max()]
            forward, recurrent = (rows[rows["planner"].isin(f)] for f in (FEED_FORWARD, RECURRENT))
            if not (forward.empty or recurrent.empty):
                return [_answer(summary, forward, recurrent)]
    return []


def _answer(summary: pd.DataFrame, forward: pd.DataFrame, recurrent: pd.DataFrame) -> Answer:
    first = forward.iloc[0]
    n, how = int(first["n"]), "as predicted" if first["reading"] == PREDICTED else "flown"
    free = summary[(summary["planner"] == FREE) & (summary["n"] == n)][COLLISIONS.source]
    quoted = paper.COLLISIONS_AT_30
    recipe = f", {first['recipe']} recipe" if first["recipe"] else ""
    return Answer(
        QUESTION,
        _verdict(forward, recurrent),
        f"node collisions at n = {n}{recipe}, {how}: {_listed(forward)} against "
        f"{_listed(recurrent)} (paper: {quoted['ff1']} at best against "
        f"{quoted['lstm1']} at worst)",
        f"Own LP: {number(float(free.iloc[0]))}" if len(free) else "",
    )


def _verdict(forward: pd.DataFrame, recurrent: pd.DataFrame) -> str:
    """A finding needs several trainings of each and a difference beyond their spread."""
    less, more = _all_below(forward, recurrent), _all_below(recurrent, forward)
    if min(int(rows["seeds"].min()) for rows in (forward, recurrent)) < 2:
        points = "points to yes" if less else "points to no" if more else "no trend"
        return f"Open: one training of some, {points}"
    return "Confirmed" if less else "Contradicted" if more else "Open: within the spread"


def _all_below(these: pd.DataFrame, those: pd.DataFrame) -> bool:
    """Whether all of these collide less than all of those, by more than the seeds' spread."""
    worst = these.sort_values(COLLISIONS.source).iloc[-1]
    best = those.sort_values(COLLISIONS.source).iloc[0]
    spreads = [float(row[COLLISIONS.spread]) for row in (worst, best)]
    difference = float(best[COLLISIONS.source]) - float(worst[COLLISIONS.source])
    return bool(difference > max([s for s in spreads if pd.notna(s)], default=0.0))


def _listed(rows: pd.DataFrame) -> str:
    return ", ".join(
        f"{name_of(str(row['planner']))} {number(float(row[COLLISIONS.source]))}"
        + ("" if pd.isna(row[COLLISIONS.spread]) else f" ± {number(row[COLLISIONS.spread])}")
        for _, row in rows.iterrows()
    )
