"""The paper's third claim, that a network's plan speeds up the optimizer that it seeds."""

import numpy as np
import pandas as pd

from pipeline.exhibits.numbers import ratio
from pipeline.exhibits.planners import is_network, label_name, planner_of
from pipeline.experiments.answer import Answer, span
from pipeline.experiments.compare import mean_interval
from pipeline.experiments.experiment3.rows import CONVERGED, EXPERT, NO_SEED, PLAIN
from pipeline.experiments.summary import reference_size

QUESTION = "Do networks' plans speed up the optimizer that they seed?"

CALLED = {PLAIN: "plain SCP", EXPERT: "our expert"}


def seeds_answer(warmstarts: pd.DataFrame) -> list[Answer]:
    """A row, where some optimizer was run with networks' seeds and without one."""
    ratios = {name: _ratios(warmstarts, optimizer) for optimizer, name in CALLED.items()}
    learned = {
        name: found.loc[[seed for seed in found.index if _of_network(seed)]]
        for name, found in ratios.items()
    }
    if all(found.empty for found in learned.values()):
        return []
    numbers = [
        f"{name}: {span(found['ratio'])} of the time without a seed, {(found['high'] < 1).sum()} "
        f"of {len(found)} networks faster beyond chance"
        for name, found in learned.items()
        if len(found)
    ]
    beside = []
    for name, found in ratios.items():
        free = found["ratio"].drop([NO_SEED, *learned[name].index], errors="ignore")
        if len(free):
            listed = ", ".join(f"{label_name(str(seed))} {ratio(r)}" for seed, r in free.items())
            beside.append(f"{name}: {listed}")
    networks = warmstarts[warmstarts["seed"].map(_of_network)]
    trainings = len(networks[["seed", "training_seed"]].drop_duplicates())
    said = _verdict(learned[CALLED[PLAIN]], learned[CALLED[EXPERT]], trainings)
    return [Answer(QUESTION, said, "; ".join(numbers), "; ".join(beside))]


def _verdict(plain: pd.DataFrame, expert: pd.DataFrame, trainings: int) -> str:
    said = []
    if len(plain):
        if trainings > 1 and (plain["high"] < 1).all():
            said.append("Confirmed for the paper's kind of optimizer from a blank start")
        elif trainings > 1 and (plain["low"] > 1).all():
            said.append("Contradicted for the paper's kind of optimizer")
        else:
            said.append("Open for the paper's kind of optimizer")
    if len(expert):
        faster = "some save time" if (expert["high"] < 1).any() else "none saves any time"
        said.append(f"with ours, {faster}")
    text = "; ".join(said)
    return text[0].upper() + text[1:]


def _ratios(warmstarts: pd.DataFrame, optimizer: str) -> pd.DataFrame:
    """By seed, time over that without one on the same trials: geometric mean and its interval."""
    found = pd.DataFrame(columns=["ratio", "low", "high"])
    rows = warmstarts[(warmstarts["optimizer"] == optimizer) & (warmstarts["rule"] == CONVERGED)]
    if NO_SEED not in set(rows["seed"]):
        return found
    rows = rows[rows["n"] == reference_size(rows)]
    logs = rows.assign(log=np.log(rows["seconds"].astype(float)))
    each = logs.groupby(["seed", "trial"])["log"].mean().unstack("seed")
    for seed in each.columns:
        longer = (each[seed] - each[NO_SEED]).dropna().to_numpy(dtype=float)
        found.loc[seed] = np.exp([longer.mean(), *mean_interval(longer)])
    return found


def _of_network(seed: str) -> bool:
    return seed != NO_SEED and is_network(planner_of(seed))
