"""Planners: which there are, what they are called and in which order they stand."""

from collections.abc import Iterable

EXPERTS = ("expert", "expert (nodes only)")
"""Centralized convex optimization."""

BASELINES = ("straight line", "minimum energy", "own LP")
"""Planners that look at one craft at a time."""

FEED_FORWARD = ("ff1", "ff2", "ffcol")
"""The paper's feed-forward networks."""

RECURRENT = ("lstm1", "lstm2", "lstmcol")
"""The paper's LSTMs."""

KNOWN = EXPERTS + BASELINES + FEED_FORWARD + RECURRENT
"""In reading order."""

NAMES = {
    "expert": "Expert",
    "expert (nodes only)": "Expert (nodes only)",
    "straight line": "Straight line",
    "minimum energy": "Minimum energy",
    "own LP": "Own LP",
    "ff1": "FF1",
    "ff2": "FF2",
    "ffcol": "FFcol",
    "lstm1": "LSTM1",
    "lstm2": "LSTM2",
    "lstmcol": "LSTMcol",
    "none": "No seed",
}


def name_of(planner: str) -> str:
    """What tables and figures call a planner or a seed."""
    return NAMES.get(planner, planner)


def planner_of(label: str) -> str:
    """The planner of a label with its recipe, such as the seed "ff1 tuned"."""
    return label.removesuffix(" tuned").removesuffix(" paper")


def label_name(label: str) -> str:
    """What tables and figures call such a label: "FF1 tuned"."""
    planner = planner_of(label)
    return name_of(planner) + label.removeprefix(planner)


def in_order(planners: Iterable[str]) -> list[str]:
    """Distinct planners: experts, baselines, feed-forward, LSTM, then others by name."""
    return sorted(set(planners), key=lambda p: (KNOWN.index(p) if p in KNOWN else len(KNOWN), p))


def is_network(planner: str) -> bool:
    """Whether a planner is neither an expert nor a baseline."""
    return planner not in EXPERTS + BASELINES
