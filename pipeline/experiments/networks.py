"""Whether networks plan safely and cheaply, at the swarm size of their training and at others."""

import pandas as pd

from pipeline.exhibits.numbers import share
from pipeline.exhibits.planners import is_network
from pipeline.experiments.answer import CHEAP, FREE, SAFE, Answer, Measured, measured
from pipeline.experiments.compare import compare, share_interval
from pipeline.experiments.paper import NETWORK_SIZE
from pipeline.experiments.trials import PREDICTED

VALIDATED = ["valid_flown_safe_share", "valid_flown_fuel", "valid_flown_trials"]

Name = tuple[str, str]
"""A network: planner and recipe."""


def picked(rows: pd.DataFrame, training: pd.DataFrame | None) -> Name | None:
    """The network that did best on validation data, of those in some rows.

    That is the cheapest of those that are as safe as the safest, but for chance: whose share of
    safe scenarios is within Wilson's interval of the highest. None where trainings did not record
    it: no network is chosen by the trials themselves.
    """
    if training is None or not {*VALIDATED} <= {*training.columns}:
        return None
    known = training.dropna(subset=VALIDATED).assign(recipe=training["recipe"].fillna(""))
    there = set(zip(rows["planner"], rows["recipe"].fillna(""), strict=True))
    means = {
        (str(arch), str(recipe)): [float(x) for x in group[VALIDATED].mean()]
        for (arch, recipe), group in known.groupby(["arch", "recipe"])
        if (arch, recipe) in there
    }
    if not means:
        return None
    share, _, trials = max(means.values())
    low, _ = share_interval(share, int(trials))
    return min((fuel, name) for name, (share, fuel, _) in means.items() if share >= low)[1]


def of(rows: pd.DataFrame, name: Name) -> pd.DataFrame:
    """The rows of one network."""
    return rows[(rows["planner"] == name[0]) & (rows["recipe"].fillna("") == name[1])]


def network_answers(trials: pd.DataFrame, training: pd.DataFrame | None, n: int) -> list[Answer]:
    """Two rows: at swarm size n, and at the largest.

    Args:
        trials: of all planners, with fuel_ratio.
        training: a row for each trained model.
        n: the swarm size of experiment 1.
    """
    plans = trials[trials["reading"] != PREDICTED]
    networks = plans[plans["planner"].map(is_network)]
    if networks.empty:
        return []
    name = picked(networks, training)
    largest = int(networks["n"].max())
    found = [
        _answer(f"Do networks plan safely and cheaply (n = {n})?", plans, name, n),
    ]
    if largest != n:
        question = f"Does a network trained at n = {NETWORK_SIZE} serve others (n = {largest})?"
        found.append(_answer(question, plans, name, largest))
    return [one for one in found if one is not None]


def _answer(question: str, plans: pd.DataFrame, name: Name | None, n: int) -> Answer | None:
    here = plans[plans["n"] == n]
    networks = here[here["planner"].map(is_network)]
    if networks.empty:
        return None
    groups = networks.assign(recipe=networks["recipe"].fillna("")).groupby(["planner", "recipe"])
    every = [measured(rows) for _, rows in groups]
    free = here[here["planner"] == FREE]
    mine = None if name is None else of(networks, name)
    parts, chosen = [], None
    if mine is not None and not mine.empty:
        chosen = measured(mine)
        parts.append(f"{chosen.name}, best on validation: {chosen.text}")
    parts.append(f"all {len(every)}: safe in {_range([one.safe for one in every])}")
    said = verdict([chosen] if chosen else every)
    if chosen and chosen.trainings == 1 and not verdict(every).startswith(said[:2]):
        said += ", for one training"
    return Answer(
        question,
        said,
        "; ".join(parts),
        _baseline(free, mine),
    )


def verdict(networks: list[Measured]) -> str:
    """What intervals leave no doubt about, for all of some networks."""
    if all(one.safe_interval[1] < SAFE for one in networks):
        dear = all(one.fuel_interval[0] > CHEAP for one in networks)
        return "No: neither safe nor cheap" if dear else "No: not safe"
    if all(one.safe_interval[0] >= SAFE for one in networks):
        if all(one.fuel_interval[1] <= CHEAP for one in networks):
            return "Yes"
        return "No: safe, not cheap" if networks[0].fuel_interval[0] > CHEAP else "Open: fuel"
    return "Open: too few trials"


def _baseline(free: pd.DataFrame, mine: pd.DataFrame | None) -> str:
    if free.empty:
        return ""
    text = f"Own LP: {measured(free).text}"
    if mine is None or mine.empty:
        return text
    held = compare(mine, free)
    low, high = held.safe_interval
    return (
        f"{text}; the network on the same trials: {100 * held.safe:+.1f} % safe "
        f"[{100 * low:+.1f}, {100 * high:+.1f}]"
    )


def _range(shares: list[float]) -> str:
    low, high = share(min(shares)), share(max(shares))
    return low if low == high else f"{low} to {high}"
