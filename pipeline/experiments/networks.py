"""Networks as planners: the one that speaks for all, and whether they plan safely and cheaply.

The paper's networks answer the paper's questions together. Any other is asked on its own.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import pandas as pd

from pipeline.exhibits.intervals import wilson
from pipeline.exhibits.numbers import share
from pipeline.exhibits.planners import in_order, is_network, is_papers, spoken_of
from pipeline.experiments.answer import CHEAP, FREE, SAFE, Answer, Measured, measured
from pipeline.experiments.compare import compare
from pipeline.experiments.trials import PREDICTED
from pipeline.experiments.verdict import at_least, at_most

VALIDATED = ["valid_flown_safe_share", "valid_flown_fuel", "valid_flown_trials"]

YES = "Yes"
"""The verdict on networks that are safe and cheap."""

Name = tuple[str, str]
"""A network: planner and recipe."""


@dataclass(frozen=True)
class Group:
    """Networks that a question is asked of.

    Attributes:
        planners: all of the paper's, or one other.
    """

    planners: tuple[str, ...]

    @property
    def papers(self) -> bool:
        """Whether they are the paper's."""
        return is_papers(self.planners[0])

    def asked(self, papers: str, other: str) -> str:
        """A question: that of the paper's networks, or that of another with its name put in."""
        return papers if self.papers else other.format(spoken_of(self.planners[0]))

    def of(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Their rows."""
        return rows[rows["planner"].isin(self.planners)]


def groups(planners: Iterable[str]) -> list[Group]:
    """The networks among some planners: the paper's together, then every other one alone."""
    networks = [p for p in in_order(planners) if is_network(p)]
    papers = tuple(filter(is_papers, networks))
    others = [Group((p,)) for p in networks if not is_papers(p)]
    return [Group(papers), *others] if papers else others


def spokesman(rows: pd.DataFrame, training: pd.DataFrame) -> tuple[Name | None, str]:
    """The network that speaks for those in some rows, and how it came to: the only one, or picked.

    Args:
        rows: from ``prepared``.
        training: a row for each trained model.
    """
    names = names_in(rows)
    if len(names) == 1:
        return names.pop(), ""
    return picked(rows, training), ", best on validation"


def picked(rows: pd.DataFrame, training: pd.DataFrame) -> Name | None:
    """The network that did best on validation data, of those in some rows.

    That is the cheapest of those that are as safe as the safest, but for chance: whose share of
    safe scenarios is within Wilson's interval of the highest. None where trainings did not record
    it: no network is chosen by the trials themselves.

    Args:
        rows: from ``prepared``.
        training: a row for each trained model.
    """
    known = training.dropna(subset=VALIDATED)
    known = known.assign(recipe=known["recipe"].fillna(""))
    there = names_in(rows)
    means = {
        (str(arch), str(recipe)): [float(x) for x in group[VALIDATED].mean()]
        for (arch, recipe), group in known.groupby(["arch", "recipe"])
        if (arch, recipe) in there
    }
    if not means:
        return None
    share, _, trials = max(means.values())
    low, _ = wilson(share, int(trials))
    return min((fuel, name) for name, (share, fuel, _) in means.items() if share >= low)[1]


def names_in(rows: pd.DataFrame) -> set[Name]:
    """The networks that have some rows."""
    return set(zip(rows["planner"], rows["recipe"], strict=True))


def of(rows: pd.DataFrame, name: Name) -> pd.DataFrame:
    """The rows of one network."""
    return rows[(rows["planner"] == name[0]) & (rows["recipe"] == name[1])]


def flown_networks(trials: pd.DataFrame) -> pd.DataFrame:
    """The trials of networks whose plans can be flown."""
    return trials[(trials["reading"] != PREDICTED) & trials["planner"].map(is_network).astype(bool)]


def network_answers(
    questions: tuple[str, str], trials: pd.DataFrame, training: pd.DataFrame, n: int
) -> list[Answer]:
    """A row for each group of networks of which any was flown at one swarm size.

    Args:
        questions: what is asked of the paper's networks, and of any other.
        trials: of all planners, from ``prepared``.
        training: a row for each trained model.
        n: the swarm size.
    """
    flown = flown_networks(trials)
    free = trials[(trials["planner"] == FREE) & (trials["n"] == n)]
    return [
        _answer(group.asked(*questions), group.of(flown), free, training, n)
        for group in groups(flown.loc[flown["n"] == n, "planner"])
    ]


def _answer(
    question: str, flown: pd.DataFrame, free: pd.DataFrame, training: pd.DataFrame, n: int
) -> Answer:
    """The row on all networks of a group, and on the one that speaks for them."""
    networks = flown[flown["n"] == n]
    every = [measured(rows) for _, rows in networks.groupby(["planner", "recipe"])]
    name, how = spokesman(flown, training)
    mine = networks.head(0) if name is None else of(networks, name)
    numbers = [f"all {len(every)}: safe in {_range([one.safe for one in every])}"] if how else []
    said = verdict(every)
    if not mine.empty:
        chosen = measured(mine)
        numbers.insert(0, f"{chosen.name}{how}: {chosen.text}")
        alone = chosen.trainings == 1 and not said.startswith(verdict([chosen])[:2])
        said = verdict([chosen]) + (", for one training" if alone else "")
    return Answer(question, said, "; ".join(numbers), _baseline(free, mine))


def verdict(networks: list[Measured]) -> str:
    """Whether some networks are all safe and cheap, by the rule of every verdict."""
    safe = {at_least(one.safe_interval, SAFE) for one in networks}
    cheap = {at_most(one.fuel_interval, CHEAP) for one in networks}
    if safe == {False}:
        return "No: neither safe nor cheap" if cheap == {False} else "No: not safe"
    if safe == {True}:
        dear = "No: safe, not cheap" if cheap == {False} else "Open: fuel"
        return YES if cheap == {True} else dear
    return "Open: too few trials" if None in safe else "In part: some are safe"


def _baseline(free: pd.DataFrame, mine: pd.DataFrame) -> str:
    if free.empty:
        return ""
    text = f"Own LP: {measured(free).text}"
    if mine.empty:
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
