"""The table of questions, which opens the report."""

from pipeline.experiments.averages import summarize
from pipeline.figures.tables import Table, Writer
from pipeline.report import Results, questions


def test_the_report_opens_with_the_questions_as_a_table(results):
    table = questions(results, summarize(results.trials), 10).values["findings"]
    assert isinstance(table, Table)
    header = table.markdown.splitlines()[0]
    titles = [title.strip() for title in header.strip("|").split("|")]
    assert titles == ["Question", "Verdict", "Numbers", "Best baseline"]
    assert (table.frame["verdict"].str.len() > 0).all()


def test_without_networks_the_questions_stay_open(trials):
    only = trials[trials["planner"].isin(["expert", "minimum energy"])]
    text = Writer().write(questions(Results(only), summarize(only), 10))
    assert "questions stay open: `prolearn train`" in text
