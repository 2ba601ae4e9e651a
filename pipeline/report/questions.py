"""The table of questions that opens the report."""

from dataclasses import asdict

import pandas as pd

from pipeline.exhibits.blocks import Block, Column, Section, Table
from pipeline.exhibits.numbers import share
from pipeline.experiments.answer import CHEAP, SAFE, with_ratio
from pipeline.experiments.experiment1.verdict import paper_answers
from pipeline.experiments.experiment2.verdict import families_answer
from pipeline.experiments.experiment3.verdict import seeds_answer
from pipeline.experiments.experiment4.verdict import times_answers
from pipeline.experiments.networks import network_answers
from pipeline.report.results import Results

TITLE = "Questions"

CAPTION = (
    "The paper's questions, and what the numbers say. Brackets are 95 % intervals: Wilson's of a "
    "share, Student's of a mean; planners that flew the same trials are compared trial by trial. "
    f"Safe means that no pair comes within the collision radius at any time, in {share(SAFE)} of "
    f"trials by the whole interval; cheap, at most {CHEAP:g} times the bound on fuel. Where one "
    "network speaks for the others it was picked on validation data, never by these trials. The "
    "baseline, each craft's own optimum, costs nothing."
)


def questions_section(results: Results, summary: pd.DataFrame, n: int) -> Section:
    """Question, verdict, numbers and best free baseline; what is missing says how to get it.

    Args:
        results: what the experiments left.
        summary: of all trials, from ``summarize``.
        n: the swarm size of experiment 1.
    """
    answers = [
        *network_answers(with_ratio(results.trials), results.training, n),
        *families_answer(summary),
        *seeds_answer(results.warmstarts),
        *times_answers(results.transfer_times, results.training),
        *paper_answers(summary),
    ]
    blocks: list[Block] = list(results.notes)
    if not answers:
        blocks.append(
            "No network was evaluated, so the paper's questions stay open: `prolearn train`, then "
            "`prolearn evaluate`, answer them."
        )
        return Section(TITLE, blocks)
    columns = [
        Column("Question", "question"),
        Column("Verdict", "verdict"),
        Column("Numbers", "numbers"),
        Column("Best free baseline", "baseline"),
    ]
    frame = pd.DataFrame([asdict(answer) for answer in answers])
    return Section(TITLE, [Table("questions", CAPTION, frame, columns), *blocks])
