"""The table of questions, which opens the report."""

from pipeline.exhibits.blocks import Table
from pipeline.exhibits.sections import Writer
from pipeline.experiments.summary import summarize
from pipeline.report import Results
from pipeline.report.questions import section


def test_the_report_opens_with_the_questions_as_a_table(results):
    table = section(results, summarize(results.trials), 10).values["answers"]
    assert isinstance(table, Table)
    header = table.markdown.splitlines()[0]
    titles = [title.strip() for title in header.strip("|").split("|")]
    assert titles == ["Question", "Verdict", "Numbers", "Best free baseline"]
    assert (table.frame["verdict"].str.len() > 0).all()


def test_without_networks_the_questions_stay_open(trials):
    only = trials[trials["planner"].isin(["expert", "minimum energy"])]
    text = Writer().write(section(Results(only), summarize(only), 10))
    assert "questions stay open: `prolearn train`" in text
