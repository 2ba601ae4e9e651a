"""The verdicts of experiment 1: on networks at n = 10, and on the paper's Table 2."""

import pandas as pd

from pipeline.exhibits.numbers import number
from pipeline.exhibits.planners import is_network, name_of
from pipeline.experiments.answer import FREE, Answer, span
from pipeline.experiments.networks import network_answers
from pipeline.experiments.paper import NETWORK_SIZE, OBJECTIVES
from pipeline.experiments.summary import COLLISIONS, FUEL
from pipeline.experiments.trials import FLOWN, PREDICTED

NEAR = 2.0
"""Factor either way within which a number is called near the paper's."""

FEWER, CHEAPER = 0.5, 0.1
"""What the tuned networks are held to: shares of the paper's collisions and fuel."""


def networks_answer(trials: pd.DataFrame, training: pd.DataFrame, n: int) -> list[Answer]:
    """A row for each group of networks that were flown at swarm size n.

    Args:
        trials: from ``prepared``.
        training: a row for each trained model.
        n: the swarm size.
    """
    asked = f"plan safely and cheaply (n = {n})?"
    questions = f"Do the paper's networks {asked}", f"Does {{}} {asked}"
    return network_answers(questions, trials, training, n)


def paper_answers(summary: pd.DataFrame) -> list[Answer]:
    """Two rows, one for each recipe that networks of the paper were trained by.

    Args:
        summary: from ``summarize``.
    """
    here = summary[summary["n"] == NETWORK_SIZE]
    beside = "".join(
        f"Own LP: {number(row[COLLISIONS.source])} collisions, fuel {number(row[FUEL.source])}"
        for row in here[here["planner"] == FREE].to_dict("records")
    )
    found = []
    if not (rows := _over_paper(here, "paper", PREDICTED)).empty:
        near = [_near(rows, column) for column in ("collisions", "fuel")]
        said = "Yes" if all(len(x) == len(rows) for x in near) else "In part" if any(near) else "No"
        numbers = (
            f"as predicted, collisions {span(rows['collisions'])} and fuel {span(rows['fuel'])} "
            f"times the paper's; within a factor of {NEAR:g}: collisions {_listed(near[0])}, fuel "
            f"{_listed(near[1])}"
        )
        question = "Does the paper's recipe give the paper's Table 2?"
        found.append(Answer(question, said, numbers, beside))
    if not (rows := _over_paper(here, "tuned", FLOWN)).empty:
        fewer, cheaper = (rows["collisions"] <= FEWER).sum(), (rows["fuel"] <= CHEAPER).sum()
        numbers = (
            f"flown, collisions {span(rows['collisions'])} and fuel {span(rows['fuel'])} times "
            f"the paper's; {fewer} and {cheaper} of {len(rows)} so good"
        )
        said = "Yes" if fewer == cheaper == len(rows) else "In part" if fewer + cheaper else "No"
        question = "Has the tuned recipe half of its collisions at a tenth of its fuel?"
        found.append(Answer(question, said, numbers, beside))
    return found


def _over_paper(summary: pd.DataFrame, recipe: str, reading: str) -> pd.DataFrame:
    """Collisions and fuel of the paper's networks over the paper's, by name."""
    known = summary["planner"].isin([planner for planner in OBJECTIVES if is_network(planner)])
    rows = summary[known & (summary["recipe"] == recipe) & (summary["reading"] == reading)]
    quoted = [OBJECTIVES[planner] for planner in rows["planner"]]
    return pd.DataFrame(
        {
            "name": [name_of(planner) for planner in rows["planner"]],
            "collisions": list(rows[COLLISIONS.source] / [row.collisions_mean for row in quoted]),
            "fuel": list(rows[FUEL.source] / [row.fuel_mean for row in quoted]),
        }
    )


def _near(rows: pd.DataFrame, column: str) -> list[str]:
    return list(rows.loc[rows[column].between(1 / NEAR, NEAR), "name"])


def _listed(names: list[str]) -> str:
    return ", ".join(names) or "none"
