"""Planners: which there are, what they are called and in which order they stand."""

from collections.abc import Iterable

from pipeline.text import visible

EXPERTS = {"expert": "Expert", "expert (nodes only)": "Expert (nodes only)"}
"""Centralized convex optimization; what it is called by the planner's name."""

BASELINES = {
    "straight line": "Straight line",
    "minimum energy": "Minimum energy",
    "own LP": "Own LP",
}
"""Planners that look at one craft at a time."""

FEED_FORWARD = {"ff1": "FF1", "ff2": "FF2", "ffcol": "FFcol"}
"""The paper's feed-forward networks."""

RECURRENT = {"lstm1": "LSTM1", "lstm2": "LSTM2", "lstmcol": "LSTMcol"}
"""The paper's LSTMs."""

BARGAINING = {"refiner": "Refiner"}
"""Of craft that bargain over who gives way; the paper has none."""

KNOWN = EXPERTS | BASELINES | FEED_FORWARD | RECURRENT | BARGAINING
"""All of them, in reading order."""


def name_of(planner: str) -> str:
    """What tables and figures call a planner or a seed."""
    return "No seed" if planner == "none" else KNOWN.get(planner, visible(planner))


def planner_of(label: str) -> str:
    """The planner of a label with its recipe, such as the seed "ff1 tuned"."""
    return label.removesuffix(" tuned").removesuffix(" paper")


def label_name(label: str) -> str:
    """What tables and figures call such a label: "FF1 tuned"."""
    planner = planner_of(label)
    return name_of(planner) + label.removeprefix(planner)


def in_order(planners: Iterable[str]) -> list[str]:
    """Distinct planners: experts, baselines, feed-forward, LSTM, refiner, then others by name."""
    known = list(KNOWN)
    return sorted(set(planners), key=lambda p: (known.index(p) if p in known else len(known), p))


def is_network(planner: str) -> bool:
    """Whether a planner is neither an expert nor a baseline."""
    return planner not in EXPERTS | BASELINES


def spoken_of(planner: str) -> str:
    """What a sentence calls a network."""
    return f"the {planner}" if planner in BARGAINING else name_of(planner)


def is_papers(planner: str) -> bool:
    """Whether a planner is a network of the paper's, be it of one version alone ("ff1/3")."""
    return planner.partition("/")[0] in FEED_FORWARD | RECURRENT
