"""The opening paragraph: the paper's two questions, and one finding, answered by the numbers."""

from collections.abc import Sequence
from typing import Any

import pandas as pd

from pipeline.report.numbers import number, ratio, share
from pipeline.report.paper_values import NETWORK_SIZE
from pipeline.report.planners import FEED_FORWARD, RECURRENT, is_network, name_of
from pipeline.report.results import FLOWN, PREDICTED

SAFE = 0.99
"""Share of trials without a conflict from which a planner is called safe."""

MOSTLY_SAFE = 0.9
"""Share of trials without a conflict from which a planner is called mostly safe."""

CHEAP = 1.1
"""Fuel as a multiple of the lower bound up to which a planner is called cheap."""


def answers(summary: pd.DataFrame, n: int) -> str:
    """The opening paragraph in Markdown.

    Args:
        summary: of all trials, from ``summarize``.
        n: the swarm size of experiment 1.
    """
    flown = summary[(summary["reading"] == FLOWN) & summary["planner"].map(is_network)]
    if flown.empty:
        return (
            "No network was flown in these trials, so the paper's two questions stay open: "
            "`prolearn train`, then `prolearn evaluate`, answer them."
        )
    sentences = [_safe_and_cheap(summary, flown, n), _other_sizes(flown, n), _families(summary)]
    return " ".join(s for s in sentences if s)


def _safe_and_cheap(summary: pd.DataFrame, flown: pd.DataFrame, n: int) -> str:
    question = "**Can networks produce safe and cheap trajectories?**"
    here = flown[flown["n"] == n]
    if here.empty:
        return f"{question} No network was flown at n = {n}."
    best = _safest(here)
    text = (
        f"{question} {_verdict(best['safe_share'], best['fuel_ratio'])}: at n = {n} the safest "
        f"network, {_called(best)}, flown exactly, keeps every pair apart at all times in "
        f"{share(best['safe_share'])} of {best['trials']} trials and burns "
        f"{ratio(best['fuel_ratio'])} times the lower bound on fuel."
    )
    others = summary[(summary["n"] == n) & (summary["reading"] != PREDICTED)]
    against = [
        f"the {who} {share(row['safe_share'])} at {ratio(row['fuel_ratio'])}"
        for planner, who in (
            ("expert", "expert"),
            ("minimum energy", "closed-form minimum-energy transfer"),
        )
        for row in _rows(others[others["planner"] == planner].head(1))
    ]
    paper = here[here["recipe"] == "paper"]
    if best["recipe"] != "paper" and not paper.empty:
        row = _safest(paper)
        against.append(
            f"the safest network of the paper's recipe, {name_of(row['planner'])}, "
            f"{share(row['safe_share'])} at {ratio(row['fuel_ratio'])}"
        )
    return text + (f" For comparison: {'; '.join(against)}." if against else "")


def _other_sizes(flown: pd.DataFrame, n: int) -> str:
    question = f"**Does a network trained at n = {NETWORK_SIZE} serve other n?**"
    sizes = sorted(int(k) for k in flown["n"].unique())
    if len(sizes) < 2:
        return f"{question} Only n = {sizes[0]} was evaluated, so this stays open."
    best = _safest(flown[flown["n"] == sizes[-1]])
    same = flown[(flown["planner"] == best["planner"]) & (flown["recipe"] == best["recipe"])]
    worst = _rows(same.sort_values(["safe_share", "n"]))[0]
    verdict = {"Safe": "Yes", "Mostly safe": "Mostly"}.get(
        _safety(worst["safe_share"]), "Not safely on its own"
    )
    home = _rows(same[same["n"] == n])
    there = (
        f", against {share(home[0]['safe_share'])} and {ratio(home[0]['fuel_ratio'])} at n = {n}"
        if home and sizes[-1] != n
        else ""
    )
    lowest = (
        "none of its trials is unsafe"
        if worst["safe_share"] == 1
        else f"its share of safe trials is lowest at n = {worst['n']} "
        f"({share(worst['safe_share'])})"
    )
    return (
        f"{question} {verdict}: at n = {sizes[-1]} the safest network, {_called(best)}, is safe in "
        f"{share(best['safe_share'])} of the trials at {ratio(best['fuel_ratio'])} times the "
        f"bound{there}; over n = {same['n'].min()} to {same['n'].max()} {lowest}."
    )


def _families(summary: pd.DataFrame) -> str:
    """Whether the feed-forward networks have fewer collisions than the LSTMs at the largest n."""
    rows = summary[summary["planner"].isin(FEED_FORWARD + RECURRENT)]
    # The paper's own setting first; within it the paper's reading, raw predictions.
    for recipe in ("paper", "tuned", ""):
        for reading in (PREDICTED, FLOWN):
            chosen = rows[(rows["recipe"] == recipe) & (rows["reading"] == reading)]
            chosen = chosen[chosen["n"] == chosen["n"].max()]
            forward = chosen[chosen["planner"].isin(FEED_FORWARD)]
            recurrent = chosen[chosen["planner"].isin(RECURRENT)]
            if not forward.empty and not recurrent.empty:
                return _compare(forward, recurrent, recipe, reading)
    return ""


def _compare(forward: pd.DataFrame, recurrent: pd.DataFrame, recipe: str, reading: str) -> str:
    if _all_below(forward, recurrent):
        verdict = "confirm"
    elif _all_below(recurrent, forward):
        verdict = "contradict"
    else:
        verdict = "neither confirm nor contradict"
    setting = f"the {recipe} recipe, " if recipe else ""
    how = "as predicted" if reading == PREDICTED else "flown exactly"
    return (
        f"The paper finds that at n = 30 every feed-forward network has fewer than half the "
        f"collisions of the LSTMs (best FF1 with 4.64 on average, worst LSTM1 with 14.74); our "
        f"numbers {verdict} that feed-forward networks collide less: at n = "
        f"{forward['n'].iloc[0]} over {forward['trials'].min()} trials, {setting}{how}, "
        f"{_listed(forward)} against {_listed(recurrent)}."
    )


def _all_below(these: pd.DataFrame, those: pd.DataFrame) -> bool:
    """Whether all of these collide less than all of those, by more than the seeds' spread."""
    worst = _rows(these.sort_values("collisions_mean"))[-1]
    best = _rows(those.sort_values("collisions_mean"))[0]
    spreads = [row["collisions_spread"] for row in (worst, best)]
    difference = best["collisions_mean"] - worst["collisions_mean"]
    return bool(difference > max([s for s in spreads if pd.notna(s)], default=0.0))


def _listed(rows: pd.DataFrame) -> str:
    return ", ".join(
        f"{name_of(r['planner'])} {number(r['collisions_mean'])}"
        + ("" if pd.isna(r["collisions_spread"]) else f" ± {number(r['collisions_spread'])}")
        for r in _rows(rows)
    )


def _safest(rows: pd.DataFrame) -> dict[str, Any]:
    ranked = rows.sort_values(["safe_share", "fuel_ratio"], ascending=[False, True], kind="stable")
    return _rows(ranked)[0]


def _rows(frame: pd.DataFrame) -> Sequence[dict[str, Any]]:
    return [{str(k): v for k, v in row.items()} for row in frame.to_dict("records")]


def _called(row: dict[str, Any]) -> str:
    recipe = f" ({row['recipe']} recipe)" if row["recipe"] else ""
    return f"{name_of(row['planner'])}{recipe}"


def _safety(safe_share: float) -> str:
    if safe_share >= SAFE:
        return "Safe"
    return "Mostly safe" if safe_share >= MOSTLY_SAFE else "Not safe"


def _verdict(safe_share: float, fuel_ratio: float) -> str:
    safety, cheap = _safety(safe_share), fuel_ratio <= CHEAP
    if safety == "Not safe":
        return "Cheap, but not safe" if cheap else "Neither safe nor cheap"
    yes = "Yes, safe" if safety == "Safe" else safety
    return f"{yes} and cheap" if cheap else f"{safety}, but not cheap"
