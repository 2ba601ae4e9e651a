"""The table of questions that opens the report: the paper's, and every experiment's verdict."""

from dataclasses import asdict

import pandas as pd

from pipeline.exhibits.blocks import Column, Table
from pipeline.exhibits.numbers import share
from pipeline.exhibits.sections import Section
from pipeline.experiments.ablations.verdict import ablation_answers
from pipeline.experiments.answer import CHEAP, SAFE
from pipeline.experiments.beyond.rows import shown_beyond
from pipeline.experiments.beyond.verdict import carry_answers
from pipeline.experiments.experiment1.verdict import networks_answer, paper_answers
from pipeline.experiments.experiment2.verdict import families_answer, others_answer
from pipeline.experiments.experiment3.verdict import seeds_answer
from pipeline.experiments.experiment4.verdict import times_answers
from pipeline.experiments.experiment5.verdict import flight_answers
from pipeline.experiments.summary import prepared
from pipeline.report.results import Results

COLUMNS = [
    Column("Question", "question"),
    Column("Verdict", "verdict"),
    Column("Numbers", "numbers"),
    Column("Best free baseline", "baseline"),
]


def section(results: Results, summary: pd.DataFrame, n: int) -> Section:
    """Question, verdict, numbers and best free baseline; what is missing says how to get it.

    Args:
        results: what the experiments left.
        summary: of all trials, from ``summarize``.
        n: the swarm size of experiment 1.
    """
    trials = prepared(results.trials)
    answers = [
        *networks_answer(trials, results.training, n),
        *others_answer(trials, results.training, n),
        *carry_answers(shown_beyond(trials, results.training), results.training),
        *families_answer(summary),
        *seeds_answer(results.warmstarts),
        *times_answers(results.transfer_times, results.training),
        *flight_answers(results.flights),
        *ablation_answers(results.ablations),
        *paper_answers(summary),
    ]
    table = Table("questions", pd.DataFrame(map(asdict, answers)), COLUMNS) if answers else None
    values = {"answers": table, "notes": results.notes, "safe": share(SAFE), "cheap": CHEAP}
    return Section("pipeline/report/questions.md.jinja", values)
