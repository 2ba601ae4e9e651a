"""The paper's third claim, that a network's plan speeds up the optimizer that it seeds."""

import numpy as np
import pandas as pd

from pipeline.exhibits.numbers import ratio
from pipeline.exhibits.planners import is_network, label_name, planner_of
from pipeline.experiments.answer import Answer, span
from pipeline.experiments.compare import Interval, mean_interval
from pipeline.experiments.experiment3.rows import CONVERGED, EXPERT, NO_SEED, PLAIN
from pipeline.experiments.summary import reference_size

QUESTION = "Do networks' plans speed up the optimizer that they seed?"


def seeds_answer(warmstarts: pd.DataFrame) -> list[Answer]:
    """A row, where some optimizer was run with networks' seeds and without one."""
    times = {name: _ratios(warmstarts, name) for name in (PLAIN, EXPERT)}
    networks = {name: {s: r for s, r in times[name].items() if _of_network(s)} for name in times}
    if not any(networks.values()):
        return []
    called = {PLAIN: "plain SCP", EXPERT: "our expert"}
    numbers = [
        f"{called[name]}: {span([r for r, _ in found.values()])} of the time without a seed, "
        f"{sum(high < 1 for _, (_, high) in found.values())} of {len(found)} networks faster "
        "beyond chance"
        for name, found in networks.items()
        if found
    ]
    free = [
        f"{called[name]}: "
        + ", ".join(f"{label_name(s)} {ratio(r)}" for s, (r, _) in found.items() if s != NO_SEED)
        for name, found in (
            (name, {s: r for s, r in times[name].items() if not _of_network(s)}) for name in times
        )
        if len(found) > 1
    ]
    return [
        Answer(
            QUESTION,
            _verdict(networks[PLAIN], networks[EXPERT], _trainings(warmstarts)),
            "; ".join(numbers),
            "; ".join(free),
        )
    ]


def _verdict(
    plain: dict[str, tuple[float, Interval]],
    expert: dict[str, tuple[float, Interval]],
    trainings: int,
) -> str:
    said = []
    if plain:
        all_faster = all(high < 1 for _, (_, high) in plain.values())
        none_faster = all(low > 1 for _, (low, _) in plain.values())
        if all_faster and trainings > 1:
            said.append("Confirmed for the paper's kind of optimizer from a blank start")
        elif none_faster and trainings > 1:
            said.append("Contradicted for the paper's kind of optimizer")
        else:
            said.append("Open for the paper's kind of optimizer")
    if expert:
        any_faster = any(high < 1 for _, (_, high) in expert.values())
        said.append("with ours, some save time" if any_faster else "with ours, none saves any time")
    text = "; ".join(said)
    return text[0].upper() + text[1:]


def _ratios(warmstarts: pd.DataFrame, optimizer: str) -> dict[str, tuple[float, Interval]]:
    """By seed, time over that without one on the same trials: geometric mean and its interval."""
    rows = warmstarts[(warmstarts["optimizer"] == optimizer) & (warmstarts["rule"] == CONVERGED)]
    if rows.empty:
        return {}
    rows = rows[rows["n"] == reference_size(rows)]
    logs = rows.assign(log=np.log(rows["seconds"].astype(float)))
    each = logs.groupby(["seed", "trial"])["log"].mean().unstack("seed")
    if NO_SEED not in each:
        return {}
    found = {}
    for seed in each.columns:
        difference = (each[seed] - each[NO_SEED]).dropna().to_numpy(dtype=float)
        low, high = mean_interval(difference)
        found[str(seed)] = (
            float(np.exp(difference.mean())),
            (float(np.exp(low)), float(np.exp(high))),
        )
    return found


def _trainings(warmstarts: pd.DataFrame) -> int:
    networks = warmstarts[warmstarts["seed"].map(_of_network)]
    return len(networks[["seed", "training_seed"]].drop_duplicates())


def _of_network(seed: str) -> bool:
    return seed != NO_SEED and is_network(planner_of(seed))
