"""Ablations of the refiner: safety and fuel without each of its parts, from stored trials.

``python -m benchmarks.ablate`` makes such trials; every ablation is the tuned recipe but for one
thing and for its epochs, of which ``short`` has as few.
"""

from collections.abc import Mapping, Sequence
from math import isnan
from typing import Any, NamedTuple

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pipeline.experiments.averages import (
    COLLISIONS,
    SECONDS,
    average,
    average_share,
    averaged,
    draw_lines,
    planner_handles,
    prepared,
    wide,
    wide_column,
)
from pipeline.experiments.findings import (
    CHANCE,
    DECOUPLED,
    Finding,
    Rules,
    compare,
    decide,
    measured,
)
from pipeline.figures.intervals import Interval
from pipeline.figures.labels import MISSING, count, name_of, number
from pipeline.figures.style import GREY, PAGE_WIDTH, REFERENCE, Style, fit_scale, in_style
from pipeline.figures.tables import Column, Picture, Section, Table

TUNED, SHORT, LABELLED = "tuned", "short", "labelled"
RULE, NULL_SPACE = "rule", "rule, null space"

PARTS = {"no-third": "what other sides say", "uncrowded": "crowded swarms to learn from"}
"""What the refiners lack that lack one part, by recipe."""

LACKS = {
    TUNED: "nothing",
    SHORT: "most epochs",
    **PARTS,
    LABELLED: "most epochs, but has labels",
    RULE: "learning",
    NULL_SPACE: "learning, and programs",
    DECOUPLED: "rounds",
}
"""What a row lacks, by recipe or planner, in the order of the rows."""

UNSAFE = 0.1
"""What an unsafe trial counts as in the score, as fuel over the lower bound."""


def percent(value: float) -> str:
    """A share of the bound in percent, with three significant digits; 0 for rounding."""
    if isnan(value):
        return MISSING
    return "0 %" if abs(value) < 5e-7 else f"{number(100 * value)} %"


def difference(value: float, interval: Interval) -> str:
    """A difference in percent of the bound, with its sign and interval."""
    shown, low, high = map(_signed, (value, *interval))
    return f"{shown} % [{low}, {high}]"


def _signed(value: float) -> str:
    """In percent; more decimals are of no use to anyone."""
    text = f"{100 * value:+.3f}"
    return text.lstrip("+-") if float(text) == 0 else text


UNSAFE_SHARE = average_share(
    *("Unsafe", "unsafe_share"), spread="unsafe_spread", of="unsafe", label="unsafe trials (%)"
)
EXCESS = average(
    *("Fuel over bound, av.", "excess_mean", percent),
    of="excess",
    label="fuel over bound, average (%)",
)
SCORE = average("Score, av.", "score_mean", percent, of="score")

COLUMNS = [
    *(Column("Refiner", "name"), Column("Lacks", "lacks"), UNSAFE_SHARE, COLLISIONS, EXCESS),
    *(Column("Score, over short", "against_short"), SECONDS),
]
"""Columns of the table of one family and n."""


def section(ablations: pd.DataFrame, look: Mapping[str, Style]) -> Section:
    """Tables for each family and n, and safety and fuel against the number of rounds."""
    values: dict[str, Any] = {"parts": {}}
    if not ablations.empty:
        summary, trials = summarize_ablations(ablations), by_scenarios(scored(ablations))
        each = by_scenarios(summary)
        values = {
            "parts": {at: parts_table(at, trials[at], rows) for at, rows in each.items()},
            "rounds": {at: rounds_table(at, rows) for at, rows in each.items()},
            "own": int(summary["own_rounds"].iloc[0]),
            "trainings": int(summary["seeds"].max()),
            "picture": Picture("ablations", rounds_figure(summary, look)),
            "unsafe": UNSAFE,
        }
    return Section("pipeline/experiments/ablations.md.jinja", values)


def scored(ablations: pd.DataFrame) -> pd.DataFrame:
    """Trials with unsafe as 1 or 0, excess, fuel over the bound less 1, and score.

    The score is what refiners are trained for: the excess, and UNSAFE more where a trial is
    unsafe. Of two planners, one with less excess may just have given way too little.
    """
    rows = prepared(ablations)
    unsafe, excess = 1 - rows["safe"], rows["fuel_ratio"] - 1
    return rows.assign(unsafe=unsafe, excess=excess, score=excess + UNSAFE * unsafe)


def by_scenarios(rows: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """The rows of each family and n, by their label, those of the paper's family first."""
    found = {
        ("" if family == "rings" else f"{family}, ", int(str(n))): part
        for (family, n), part in rows.groupby(["family", "n"])
    }
    return {f"{family}n = {n}": found[family, n] for family, n in sorted(found)}


def summarize_ablations(ablations: pd.DataFrame) -> pd.DataFrame:
    """Averages over the trials of each planner and recipe after each number of rounds.

    Returns:
        planner, recipe, family, n, rounds, own_rounds (those of an answer), name, lacks, seeds,
        trials and averages, in the order of LACKS.
    """
    rows, group = scored(ablations), ["family", "n", "planner", "recipe", "rounds"]
    summary = averaged(rows, group, (UNSAFE_SHARE, COLLISIONS, EXCESS, SCORE, SECONDS))
    keys = [r or p for p, r in zip(summary["planner"], summary["recipe"], strict=True)]
    places = {key: place for place, key in enumerate(LACKS)}
    summary = summary.assign(
        own_rounds=int(rows["own_rounds"].iloc[0]) if len(rows) else 0,
        name=[_name(*who) for who in zip(summary["planner"], summary["recipe"], strict=True)],
        lacks=[LACKS.get(key, "") for key in keys],
        place=[places.get(key, len(places)) for key in keys],
    )
    order = ["family", "n", "place", "recipe", "planner", "rounds"]
    return summary.sort_values(order, ignore_index=True).drop(columns="place")


def _name(planner: str, recipe: str) -> str:
    if planner in (RULE, NULL_SPACE):
        return planner.replace("rule", "Rule alone")
    if not recipe:
        return name_of(planner)
    return recipe if planner == "refiner" else f"{recipe} ({planner})"


def of_answers(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows of answers as they are, with the decoupled optima, which no rounds give."""
    return rows[(rows["rounds"] == rows["own_rounds"]) | (rows["planner"] == DECOUPLED)]


def parts_table(at: str, trials: pd.DataFrame, summary: pd.DataFrame) -> Table:
    """Each refiner at the rounds of its answer, the rule alone and the decoupled optima.

    Args:
        at: label of the scenarios.
        trials: scored.
        summary: of these trials.
    """
    frame, trials = of_answers(summary).reset_index(drop=True), of_answers(trials)
    short = trials[trials["recipe"] == SHORT]
    rows: list[tuple[Any, ...]] = []
    for planner, recipe in frame[["planner", "recipe"]].itertuples(index=False):
        mine = trials[(trials["planner"] == planner) & (trials["recipe"] == recipe)]
        if short.empty or recipe == SHORT:
            rows.append((None, None, None, MISSING))
        else:
            held = compare(mine, short, "score")
            text = difference(held.fuel, held.fuel_interval)
            rows.append((held.fuel, *held.fuel_interval, text))
    columns = ["score_over_short", "score_low", "score_high", "against_short"]
    frame = frame.join(pd.DataFrame(rows, columns=columns))
    return Table(f"ablations-{_slug(at)}", frame, COLUMNS, int(frame["seeds"].max()))


def lines_of(summary: pd.DataFrame) -> pd.DataFrame:
    """The rows of tuned, short and the rule, each begun at 0 rounds by the decoupled optima."""
    drawn = summary[summary["recipe"].isin([TUNED, SHORT]) | (summary["planner"] == RULE)]
    drawn = drawn[drawn["rounds"] > 0]
    starts = summary[summary["planner"] == DECOUPLED]
    begun = [starts.assign(name=name) for name in dict.fromkeys(drawn["name"])]
    return pd.concat([*begun, drawn], ignore_index=True)


def rounds_table(at: str, summary: pd.DataFrame) -> Table:
    """A row for each number of rounds: unsafe trials and fuel of tuned, short and the rule."""
    lines = lines_of(summary).sort_values("rounds", kind="stable")
    frame, columns = lines[["rounds"]].drop_duplicates(), [Column("Rounds", "rounds", count)]
    for name in dict.fromkeys(lines_of(summary)["name"]):
        for title, one in (("unsafe", UNSAFE_SHARE), ("fuel over bound", EXCESS)):
            heading = f"{name} {one.source}"
            mine = lines[lines["name"] == name].assign(heading=heading)
            frame = frame.merge(wide(mine, ["rounds"], "heading", one), on="rounds", how="left")
            columns.append(wide_column(frame, heading, f"{name}, {title}", one))
    return Table(f"ablations-rounds-{_slug(at)}", frame, columns, int(lines["seeds"].max()))


def _slug(at: str) -> str:
    return at.replace(", ", "-").replace(" = ", "")


@in_style
def rounds_figure(summary: pd.DataFrame, look: Mapping[str, Style]) -> Figure:
    """Unsafe trials above, fuel over its bound below; a column for each family and n.

    The dashed line is the number of rounds that an answer takes; a band is the standard deviation
    between trainings, where there are several.
    """
    lines, drawn = lines_of(summary), (UNSAFE_SHARE, EXCESS)
    shown = {column: 100 * lines[column] for one in drawn for column in (one.source, one.spread)}
    lines = lines.assign(planner=lines["name"], **shown)
    named = {name: Style("#E69F00", "s", "--") for name in lines["name"]}
    named |= {TUNED: Style(look["refiner"].colour, "o", "-"), "Rule alone": Style(GREY, "x", ":")}
    parts = by_scenarios(lines)
    width = PAGE_WIDTH if len(parts) > 1 else 0.6 * PAGE_WIDTH
    figure = Figure(figsize=(width, 5.2), layout="constrained")
    panels = figure.subplots(2, len(parts), sharex=True, squeeze=False)
    for (unsafe, fuel), (at, rows) in zip(panels.T, parts.items(), strict=True):
        draw_lines(unsafe, rows, "rounds", UNSAFE_SHARE, named)
        fit_scale(unsafe, "y", lines[UNSAFE_SHARE.source])  # the same on each
        draw_lines(fuel, rows[rows["rounds"] > 0], "rounds", EXCESS, named)
        for ax in (unsafe, fuel):
            ax.axvline(int(summary["own_rounds"].iloc[0]), zorder=1, **REFERENCE)
        unsafe.set_title(at)
        fuel.set_xlabel("rounds")
        fuel.xaxis.set_major_locator(MaxNLocator(nbins=7, integer=True))
    for ax, one in zip(panels[:, 0], drawn, strict=True):
        ax.set_ylabel(one.label)
    handles = planner_handles(lines["name"], named)
    figure.legend(handles=handles, loc="outside lower center", ncols=4, handlelength=3)
    return figure


BOUGHT: Rules = (
    ((True, True), "safer and cheaper"),
    ((True, False), "safer but dearer"),
    ((True, None), "safer"),
    ((False, True), "less safe but cheaper"),
    ((False, False), "less safe and dearer"),
    ((False, None), "less safe"),
    ((None, True), "cheaper"),
    ((None, False), "dearer"),
    ((None, None), "nothing beyond chance"),
)
"""By whether plans are safer, and cheaper; None where it may be chance."""

MISSED: Rules = (
    ((True, True), "yes, without any of them"),
    ((True, False), "only without {worse}"),
    ((False, False), "not beyond noise"),
)
"""By whether the refiner is worse without any part, and without each."""

HARM: Rules = (((True,), "harm"), ((False,), "help"), ((None,), "no difference beyond noise"))
"""By whether the refiner is worse."""


class Cost(NamedTuple):
    """Score of a refiner over that of ``short`` on the same trials, as a share of the bound."""

    recipe: str
    score: float
    interval: Interval  # of the mean over the trials
    spread: float  # the larger standard deviation between trainings of either; 0 where one

    @property
    def worse(self) -> bool | None:
        """Whether it is worse, or not, beyond chance and the spread between trainings."""
        low, high = self.interval
        if low > 0 and self.score > self.spread:
            return True
        return False if high < 0 and -self.score > self.spread else None


def costs(rows: pd.DataFrame, recipes: Sequence[str]) -> list[Cost]:
    """What other ways to be trained cost, the dearest first; none where ``short`` was not tried."""
    short = rows[rows["recipe"] == SHORT]
    found: list[Cost] = []
    for recipe in recipes if len(short) else ():
        if len(mine := rows[rows["recipe"] == recipe]):
            held = compare(mine, short, "score")
            found.append(
                Cost(recipe, held.fuel, held.fuel_interval, max(map(_spread, (mine, short))))
            )
    return sorted(found, key=lambda cost: -cost.score)


def _spread(rows: pd.DataFrame) -> float:
    """Standard deviation of the score between trainings."""
    each = rows.groupby("training_seed")["score"].mean()
    return float(each.std()) if len(each) > 1 else 0.0


def findings(ablations: pd.DataFrame) -> list[Finding]:
    """A row on learning, one on parts and one on labels, where refiners were tried that tell."""
    if ablations.empty:
        return []
    on = by_scenarios(of_answers(scored(ablations)))
    free = {at: rows[rows["planner"] == DECOUPLED] for at, rows in on.items()}
    beside = _joined({at: f"Own LP: {measured(x).text}" for at, x in free.items() if len(x)})
    asked = {
        "What does learning buy over the refiner's rule alone?": _learning,
        "Is the refiner worse without each of its parts?": _parts,
        "Do the expert's plans as labels help the refiner to learn?": _labels,
    }
    found: list[Finding] = []
    for question, answer in asked.items():
        answers = {at: one for at, rows in on.items() if (one := answer(rows))}
        if answers:
            said = _joined({at: verdict for at, (verdict, _) in answers.items()})
            numbers = _joined({at: numbers for at, (_, numbers) in answers.items()})
            found.append(Finding(question, said, numbers, "" if found else beside))
    return found


def _learning(rows: pd.DataFrame) -> tuple[str, str] | None:
    """The tuned refiner, or the short one where there is no other, beside the rule."""
    rule = rows[rows["planner"] == RULE]
    for recipe in (TUNED, SHORT):
        mine = rows[rows["recipe"] == recipe]
        if len(mine) and len(rule):
            held = compare(mine, rule)
            low, high = held.fuel_interval
            safer = held.safe > 0 if held.safe_by_chance <= CHANCE else None
            cheaper = True if high < 0 else False if low > 0 else None
            fuel = difference(held.fuel, held.fuel_interval)
            numbers = f"{recipe}'s fuel {fuel} of the bound, {held.safe_text}"
            return decide(BOUGHT, safer, cheaper) + _once(mine), numbers
    return None


def _parts(rows: pd.DataFrame) -> tuple[str, str] | None:
    found = costs(rows, list(PARTS))
    worse = [PARTS[one.recipe] for one in found if one.worse]
    said = decide(MISSED, bool(worse), bool(worse) and len(worse) == len(found))
    tried = rows[rows["recipe"].isin([SHORT, *PARTS])]
    return (said.format(worse=" and ".join(worse)) + _once(tried), _costs(found)) if found else None


def _labels(rows: pd.DataFrame) -> tuple[str, str] | None:
    found = costs(rows, [LABELLED])
    return (decide(HARM, found[0].worse), _costs(found)) if found else None


def _costs(found: Sequence[Cost]) -> str:
    return ", ".join(f"{one.recipe} {difference(one.score, one.interval)}" for one in found)


def _once(rows: pd.DataFrame) -> str:
    """That some recipe was trained once, so that another training may differ by as much."""
    fewest = rows.groupby("recipe")["training_seed"].nunique().min()
    return ", for one training" if fewest == 1 else ""


def _joined(said: Mapping[str, str]) -> str:
    return "; ".join(f"{at}: {text}" for at, text in said.items())
