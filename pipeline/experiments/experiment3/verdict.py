"""The paper's third claim, that a network's plan speeds up the optimizer that it seeds."""

import pandas as pd

from pipeline.exhibits.numbers import ratio
from pipeline.exhibits.planners import is_network, label_name, planner_of
from pipeline.experiments.answer import Answer, span
from pipeline.experiments.experiment3.rows import CONVERGED, EXPERT, NO_SEED, PLAIN
from pipeline.experiments.experiment3.summary import time_ratios
from pipeline.experiments.networks import Group, groups
from pipeline.experiments.summary import reference_size

ASKED = "plans speed up the optimizer that they seed?"
QUESTIONS = f"Do the paper's networks' {ASKED}", f"Do {{}}'s {ASKED}"
"""Asked of the paper's networks, and of any other."""

CALLED = {PLAIN: "plain SCP", EXPERT: "our expert"}


def seeds_answer(warmstarts: pd.DataFrame) -> list[Answer]:
    """A row for each group of networks whose plans were an optimizer's seeds, beside none."""
    ratios = {name: _ratios(warmstarts, optimizer) for optimizer, name in CALLED.items()}
    beside = "; ".join(_beside(name, found) for name, found in ratios.items() if len(found))
    answers = []
    for group in groups(map(planner_of, set(warmstarts["seed"]) - {NO_SEED})):
        learned = {name: _of(group, found) for name, found in ratios.items()}
        if any(map(len, learned.values())):
            seeds = warmstarts[warmstarts["seed"].map(planner_of).isin(group.planners)]
            trainings = len(seeds[["seed", "training_seed"]].drop_duplicates())
            said = _verdict(group, learned[CALLED[PLAIN]], learned[CALLED[EXPERT]], trainings)
            numbers = "; ".join(
                _faster(name, found) for name, found in learned.items() if len(found)
            )
            answers.append(Answer(group.asked(*QUESTIONS), said, numbers, beside))
    return answers


def _of(group: Group, ratios: pd.DataFrame) -> pd.DataFrame:
    return ratios.loc[[seed for seed in ratios.index if planner_of(seed) in group.planners]]


def _faster(name: str, found: pd.DataFrame) -> str:
    faster = int((found["time_ratio_high"] < 1).sum())
    many = f"{faster} of {len(found)} networks faster" if len(found) > 1 else "faster"
    said = many if faster or len(found) > 1 else "not faster"
    return f"{name}: {span(found['time_ratio'])} of the time without a seed, {said} beyond chance"


def _beside(name: str, ratios: pd.DataFrame) -> str:
    """The seeds that cost nothing."""
    free = {
        seed: r for seed, r in ratios["time_ratio"].items() if not is_network(planner_of(str(seed)))
    }
    listed = (f"{label_name(str(s))} {ratio(r)}" for s, r in free.items() if s != NO_SEED)
    return f"{name}: {', '.join(listed)}"


def _verdict(group: Group, plain: pd.DataFrame, expert: pd.DataFrame, trainings: int) -> str:
    said = []
    yes, no = ("Confirmed", "Contradicted") if group.papers else ("Yes", "No")
    if len(plain):
        if trainings > 1 and (plain["time_ratio_high"] < 1).all():
            said.append(f"{yes} for the paper's kind of optimizer from a blank start")
        elif trainings > 1 and (plain["time_ratio_low"] > 1).all():
            said.append(f"{no} for the paper's kind of optimizer")
        else:
            said.append("Open for the paper's kind of optimizer")
    if len(expert):
        one = "it saves time" if len(expert) == 1 else "some save time"
        none = "it saves none" if len(expert) == 1 else "none saves any"
        saves = one if (expert["time_ratio_high"] < 1).any() else "no saving is proven"
        said.append(f"with ours, {none if (expert['time_ratio_low'] > 1).all() else saves}")
    text = "; ".join(said)
    return text[0].upper() + text[1:]


def _ratios(warmstarts: pd.DataFrame, optimizer: str) -> pd.DataFrame:
    """By seed, the ratio of times at one swarm size, until converged."""
    rows = warmstarts[(warmstarts["optimizer"] == optimizer) & (warmstarts["rule"] == CONVERGED)]
    if NO_SEED not in set(rows["seed"]):
        return pd.DataFrame(columns=["time_ratio", "time_ratio_low", "time_ratio_high"])
    return time_ratios(rows[rows["n"] == reference_size(rows)]).set_index("seed")
