"""Findings: a question, its verdict by a table of rules, and the numbers that decide it."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, groupby, product

import numpy as np
import pandas as pd
from scipy import special

from pipeline.experiments.averages import Average
from pipeline.experiments.records import PREDICTED
from pipeline.figures import intervals, labels
from pipeline.figures.intervals import ConfidenceInterval, at_least, at_most

DECOUPLED = "decoupled optimum"
"""The best baseline: each craft's optimum without regard to the others, at the bound on fuel."""

SAFE = 0.95  # share of trials, by the whole of its interval, from which a planner is called safe
CHEAP = 1.1  # fuel over its bound, by the whole of its interval, up to which one is called cheap

ANY, MIXED = "any", "mixed"
"""In a rule: a claim that does not matter; one that holds for some and fails for others."""

Rules = Sequence[tuple[tuple[bool | str | None, ...], str]]
"""Patterns of claims, each True, False, None (open), MIXED or ANY, and the verdict of each."""


@dataclass(frozen=True)
class Finding:
    """A row of the table of questions."""

    question: str
    verdict: str
    numbers: str  # that decide, with their uncertainty
    baseline: str = ""  # the same numbers of the best baseline


def decide(rules: Rules, *claims: bool | str | None) -> str:
    """The verdict of the first rule whose pattern the claims match."""
    return next(
        verdict
        for pattern, verdict in rules
        if all(part is ANY or part is claim for part, claim in zip(pattern, claims, strict=True))
    )


def joint_claim(claims: Iterable[bool | None]) -> bool | str | None:
    """A claim about several planners: open if it is for any, MIXED if they differ."""
    found = set(claims)
    return None if None in found or not found else found.pop() if len(found) == 1 else MIXED


@dataclass(frozen=True)
class Performance:
    """Safety and fuel of one planner on some trials, averaged over its trainings."""

    name: str  # of the planner with its recipe
    trainings: int
    safe: float  # share of trials
    safe_interval: ConfidenceInterval  # Wilson's
    fuel: float  # over its bound, mean
    fuel_interval: ConfidenceInterval  # Student's

    @property
    def text(self) -> str:
        """Both numbers with their intervals."""
        safe = f"{labels.share(self.safe)} {labels.percents(*self.safe_interval)}"
        fuel = labels.ratio_within(self.fuel, self.fuel_interval)
        return f"safe in {safe} at {fuel} of the bound"


def performance(rows: pd.DataFrame) -> Performance:
    """The numbers of one planner's trials from ``prepared``, of one or several trainings."""
    first = rows.iloc[0]
    each = rows.groupby("trial")[["safe", "fuel_ratio"]].mean()
    safe, fuel = each["safe"].mean(), each["fuel_ratio"]
    return Performance(
        name=labels.planner_label(first["planner"], first["recipe"]),
        trainings=int(rows["training_seed"].nunique()),
        safe=float(safe),
        safe_interval=intervals.wilson(float(safe), len(each)),
        fuel=float(fuel.mean()),
        fuel_interval=intervals.mean_interval(fuel.dropna().to_numpy(dtype=float)),
    )


YES = "Yes"

SAFE_AND_CHEAP: Rules = (
    ((True, True), YES),
    ((True, False), "No: safe, not cheap"),
    ((True, ANY), "Open: fuel"),
    ((False, False), "No: neither safe nor cheap"),
    ((False, ANY), "No: not safe"),
    ((None, ANY), "Open: too few trials"),
    ((MIXED, ANY), "In part: some are safe"),
)
"""By whether planners are safe, and cheap."""

WHERE: Rules = (
    ((True, ANY, ANY), "Yes, wherever tried: {yes}"),
    ((ANY, True, True), "At {yes}; open, with too few trials: {open}"),
    ((ANY, True, False), "Only at {yes}"),
    ((ANY, False, True), "Open, with too few trials: {open}"),
    ((ANY, False, False), "No"),
)
"""By whether a planner is safe and cheap everywhere, somewhere, and open somewhere."""


def verdict_on(*planners: Performance) -> str:
    """Whether some planners are all safe and cheap."""
    return decide(
        SAFE_AND_CHEAP,
        joint_claim(at_least(one.safe_interval, SAFE) for one in planners),
        joint_claim(at_most(one.fuel_interval, CHEAP) for one in planners),
    )


def where_safe_and_cheap(at: Mapping[str, Performance]) -> str:
    """Where a planner is safe and cheap, of some swarm sizes or transfer times by their label."""
    verdict_at = {label: verdict_on(one) for label, one in at.items()}
    yes = [label for label, verdict in verdict_at.items() if verdict == YES]
    still_open = [label for label, verdict in verdict_at.items() if verdict.startswith("Open")]
    form = decide(WHERE, len(yes) == len(verdict_at), bool(yes), bool(still_open))
    return form.format(yes=_label_ranges(yes, list(at)), open=_label_ranges(still_open, list(at)))


def _label_ranges(some: Sequence[str], tried: Sequence[str]) -> str:
    """Some of the labels that were tried, as text; runs of three or more by their two ends."""
    place = {label: k for k, label in enumerate(tried)}
    runs = groupby(enumerate(some), key=lambda at: place[at[1]] - at[0])
    rows = [[label for _, label in run] for _, run in runs]
    said = [[f"{row[0]} to {row[-1]}"] if len(row) > 2 else row for row in rows]
    return ", ".join(chain.from_iterable(said))


@dataclass(frozen=True)
class PairedComparison:
    """Differences of the first of two planners from the second, on the trials of both.

    ``safe_p_value`` is that of the exact sign test on the trials in which only one of them is safe.
    """

    trials: int
    safe: float  # difference in the share of safe trials
    safe_interval: ConfidenceInterval  # Newcombe's
    safe_p_value: float
    fuel: float  # mean difference in fuel over its bound, or in the column compared instead

    @property
    def safety_differs(self) -> bool:
        """Whether the difference in safety is significant."""
        return self.safe_p_value <= 1 - intervals.CONFIDENCE

    @property
    def better(self) -> bool:
        """Whether the first is safer or, if safety does not differ significantly, cheaper."""
        return self.safe > 0 if self.safety_differs else self.fuel < 0


def compare(
    first: pd.DataFrame, second: pd.DataFrame, fuel: str = "fuel_ratio"
) -> PairedComparison:
    """Compare two planners on the trials of both, by each trial's mean of safe and ``fuel``.

    Fuel is compared on those in which both have a value.
    """
    one, other = (
        rows.assign(safe=rows["safe"].astype(float)).groupby("trial")[["safe", fuel]].mean()
        for rows in (first, second)
    )
    differences = (one - other).dropna(subset="safe")
    safe = differences["safe"]
    fewer = min((safe > 0).sum(), (safe < 0).sum())
    chance = min(1.0, 2 * special.bdtr(fewer, (safe != 0).sum(), 0.5))  # the sign test
    shares = (rows.loc[differences.index, "safe"].to_numpy(dtype=float) for rows in (one, other))
    return PairedComparison(
        trials=len(differences),
        safe=float(safe.mean()),
        safe_interval=intervals.newcombe(*shares),
        safe_p_value=float(chance),
        fuel=float(differences[fuel].dropna().astype(float).mean()),
    )


LOWER: Rules = (
    ((True, True, ANY), "Confirmed"),
    ((True, ANY, True), "Contradicted"),
    ((True, ANY, MIXED), "Contradicted by some"),
    ((True, ANY, ANY), "Open: within the spread"),
    ((False, True, ANY), "Open: only one training of some; points to yes"),
    ((False, ANY, True), "Open: only one training of some; points to no"),
    ((False, ANY, MIXED), "Open: only one training of some; some point to no"),
    ((False, ANY, ANY), "Open: only one training of some; no trend"),
)
"""By whether there are several trainings of each, all are lower than others, and all are higher."""


def verdict_on_lower(several: bool, differences: Iterable[ConfidenceInterval]) -> str:
    """Whether some numbers are lower than others, as the paper says, by intervals of differences.

    ``several``: all have several trainings. That some are higher is MIXED unless all are.
    """
    # Lower, higher or open
    claims = {True if high < 0 else False if low > 0 else None for low, high in differences}
    higher = MIXED if False in claims and len(claims) > 1 else False in claims
    return decide(LOWER, several, claims == {True}, higher)


def compare_families(
    rows: pd.DataFrame, lower: Iterable[str], others: Iterable[str], avg: Average
) -> tuple[str, str] | None:
    """Verdict on an average being lower for some networks than for others, and the numbers of both.

    Rows are those of one recipe in a summary; two networks differ where they do by more than the
    spread of either's trainings. None where there are not both.
    """
    sides = [rows[rows["planner"].isin(family)] for family in (lower, others)]
    if any(side.empty for side in sides):
        return None
    pairs = product(*(side[[avg.source, avg.spread]].to_numpy(dtype=float) for side in sides))
    differences = []
    for (mean, spread), (other, its_spread) in pairs:
        noise = np.nanmax([0.0, spread, its_spread])
        differences.append((mean - other - noise, mean - other + noise))
    several = min(int(side["seeds"].min()) for side in sides) > 1
    return verdict_on_lower(several, differences), " against ".join(_listed(s, avg) for s in sides)


def _listed(rows: pd.DataFrame, avg: Average) -> str:
    columns = rows[["planner", avg.source, avg.spread]]
    return ", ".join(
        f"{labels.name_of(planner)} {labels.number(mean, spread)}"
        for planner, mean, spread in columns.itertuples(index=False)
    )


Name = tuple[str, str]  # of a network: planner and recipe
PAPERS = "Does one of the paper's networks"  # begins most questions on them


@dataclass(frozen=True)
class Group:
    """The networks that a question is about: all of the paper's, or one other."""

    planners: tuple[str, ...]

    @property
    def papers(self) -> bool:
        """Whether they are the paper's."""
        return labels.is_of_paper(self.planners[0])

    def question(self, predicate: str, papers: str = PAPERS, other: str = "Does {}") -> str:
        """A question: its subject, the paper's networks or another by name, and its predicate."""
        begun = papers if self.papers else other.format(labels.name_in_sentence(self.planners[0]))
        return f"{begun} {predicate}"

    def of(self, rows: pd.DataFrame) -> pd.DataFrame:
        """The rows of a table that are about this group's planners."""
        return rows[rows["planner"].isin(self.planners)]


def groups(planners: Iterable[str]) -> list[Group]:
    """The networks among some planners: the paper's together, then every other one alone."""
    networks = [p for p in labels.in_order(planners) if labels.is_network(p)]
    papers = tuple(filter(labels.is_of_paper, networks))
    others = [Group((p,)) for p in networks if not labels.is_of_paper(p)]
    return [Group(papers), *others] if papers else others


VALIDATED = ["valid_flown_safe_share", "valid_flown_fuel", "valid_flown_trials"]


def representative(rows: pd.DataFrame, training: pd.DataFrame) -> Name | None:
    """The network that represents those in some rows: the only one, or the best on validation.

    The best is the cheapest of those as safe as the safest, whose share of safe scenarios is within
    Wilson's interval of the highest. None if trainings did not record validation: a network is
    never chosen by its trials.
    """
    names = networks_in(rows)
    if len(names) == 1:
        return names.pop()
    known = training.dropna(subset=VALIDATED).groupby(["arch", "recipe"])
    means = known[VALIDATED].mean().astype(float)
    means = means[means.index.isin(names)]
    if means.empty:
        return None
    shares, fuel, trials = (means[name] for name in VALIDATED)
    safest = shares.max()
    low, _ = intervals.wilson(safest, int(trials[shares == safest].max()))
    cheapest = fuel[shares >= low]
    return sorted(cheapest.index[cheapest == cheapest.min()])[0]


def networks_in(rows: pd.DataFrame) -> set[Name]:
    """The networks that have some rows."""
    return set(zip(rows["planner"], rows["recipe"], strict=True))


def rows_of(rows: pd.DataFrame, name: Name) -> pd.DataFrame:
    """The rows of one network."""
    return rows[(rows["planner"] == name[0]) & (rows["recipe"] == name[1])]


def flown_networks(trials: pd.DataFrame) -> pd.DataFrame:
    """The trials of networks whose plans can be flown."""
    of_network = trials["planner"].map(labels.is_network).astype(bool)
    return trials[of_network & (trials["reading"] != PREDICTED)]


def network_findings(
    predicate: str, trials: pd.DataFrame, training: pd.DataFrame, n: int, papers: str = PAPERS
) -> Iterator[Finding]:
    """A finding for each group of networks of which any was flown at one swarm size."""
    flown = flown_networks(trials)
    decoupled = trials[(trials["planner"] == DECOUPLED) & (trials["n"] == n)]
    for group in groups(flown.loc[flown["n"] == n, "planner"]):
        networks = group.of(flown)
        here = networks[networks["n"] == n]
        performances = [performance(rows) for _, rows in here.groupby(["planner", "recipe"])]
        name, alone = representative(networks, training), len(networks_in(networks)) == 1
        mine = here.head(0) if name is None else rows_of(here, name)
        verdict = verdict_on(*performances)
        safe = [one.safe for one in performances]
        low, high = labels.share(min(safe)), labels.share(max(safe))
        spread = low if low == high else f"{low} to {high}"
        numbers = [] if alone else [f"all {len(performances)}: safe in {spread}"]
        baseline = "" if decoupled.empty else f"Decoupled optimum: {performance(decoupled).text}"
        if not mine.empty:
            chosen = performance(mine)
            how = "" if alone else ", best on validation"
            numbers.insert(0, f"{chosen.name}{how}: {chosen.text}")
            by_itself = chosen.trainings == 1 and verdict[:2] != verdict_on(chosen)[:2]
            verdict = verdict_on(chosen) + (", for one training" if by_itself else "")
            if baseline:
                diff = compare(mine, decoupled)
                more, low, high = (f"{100 * x:+.1f}" for x in (diff.safe, *diff.safe_interval))
                baseline += f"; the network on the same trials: {more} % safe [{low}, {high}]"
        yield Finding(group.question(predicate, papers), verdict, "; ".join(numbers), baseline)
