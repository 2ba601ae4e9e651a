import base64
import re
import subprocess
import sys
from html.parser import HTMLParser

import pandas as pd
import pytest

from pipeline.experiments import experiment2, experiment3
from pipeline.experiments.averages import summarize
from pipeline.figures.style import planner_styles
from pipeline.figures.tables import Writer
from pipeline.report import Results, build_report, html_page

COMMANDS = ("warmstart", "transfer-times", "flights")
EXPERIMENTS = [f"prolearn {command}" for command in COMMANDS]


@pytest.fixture(scope="module")
def cache():
    return {}


@pytest.fixture
def report(results, cache, tmp_path_factory):
    """The full report, built once for all tests of this module."""
    if not cache:
        cache["files"] = build_report(results, tmp_path_factory.mktemp("report"))
    return cache["files"]


def written(section):
    """Names of the figures and tables of a report's section, and its Markdown."""
    writer = Writer()
    text = writer.write(section)
    return {one.name for one in (*writer.pictures, *writer.tables)}, text


class References(HTMLParser):
    def __init__(self):
        super().__init__()
        self.found, self.ids, self.tags = [], set(), []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        for name, value in attrs:
            if name in {"src", "href", "srcset", "data", "action", "poster"}:
                self.found.append(value)
            if name == "id":
                self.ids.add(value)


def test_the_page_refers_to_nothing_outside_itself(report):
    page = References()
    text = report.html.read_text()
    page.feed(text)
    assert all(v.startswith(("data:image/svg+xml;base64,", "#")) for v in page.found)
    assert {"script", "link", "iframe"}.isdisjoint(page.tags)
    assert "@import" not in text
    assert "url(" not in text


def test_printed_tables_keep_all_their_columns(report):
    printed = report.html.read_text().split("@media print", 1)[1].split("</style>")[0]
    assert ".table { overflow: visible; }" in printed
    assert "td { white-space: normal; }" in printed


def test_what_an_earlier_report_had_and_this_one_has_not_is_removed(trials_at, tmp_path):
    others = ["tables/mine.csv", "figures/experiment4-tuned.pdf", "experiment5.csv"]
    earlier = ["report.md", "tables/experiment4-safe.csv", "figures/experiment4-tuned.svg"]
    (tmp_path / "tables").mkdir()
    (tmp_path / "figures").mkdir()
    for name in (*others, *earlier):
        (tmp_path / name).touch()
    files = build_report(Results(trials_at(6)), tmp_path)
    left = {path for path in tmp_path.rglob("*") if path.is_file()}
    mine = {files.markdown, files.html, *files.tables, *files.figures}
    assert left - mine == {tmp_path / name for name in others}


def test_no_file_is_read_because_a_text_names_it(results, trials_at, tmp_path):
    (tmp_path / "secret.svg").write_text("what nobody else may read")
    asked = f"![i]({tmp_path}/secret.svg) ![i](secret.svg) ![i][r]"
    provenance = results.provenance.assign(data=asked)
    hostile = Results(trials_at(6), provenance=provenance, notes=[asked])
    text = build_report(hostile, tmp_path).html.read_text()
    assert base64.b64encode(b"what nobody else may read").decode() not in text
    assert text.count(asked) == 2


def test_the_only_images_of_a_page_are_its_figures_each_in_its_place():
    figure = "![Figure 1](figures/a.svg)"
    text = f"![a](figures/b.svg) ![b]() ![c][r] words {figure}\n\n[r]: figures/a.svg"
    page = html_page("title", f"{figure}\n*A.*\n\n{text}", {"figures/a.svg": b"<svg/>"})
    data = base64.b64encode(b"<svg/>").decode()
    assert page.count("<img") == 1
    assert f'<img alt="Figure 1" src="data:image/svg+xml;base64,{data}">' in page
    assert text.replace("\n\n", "</p>\n<p>") in page


def test_the_contents_lead_to_the_sections(report):
    page = References()
    page.feed(report.html.read_text())
    anchors = [v[1:] for v in page.found if v.startswith("#")]
    assert len(anchors) == 9
    assert set(anchors) <= page.ids


def test_every_figure_is_there_as_svg_and_png_and_named_in_the_markdown(report):
    folder = report.markdown.parent
    named = re.findall(r"\]\((figures/[^)]+\.svg)\)", report.markdown.read_text())
    assert len(named) == len(set(named)) >= 8
    for name in named:
        assert (folder / name).read_text().lstrip().startswith("<?xml")
        assert (folder / name).with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    assert {folder / n for n in named} == {f for f in report.figures if f.suffix == ".svg"}
    assert report.html.read_text().count("<figure>") == len(named)


def test_every_table_is_there_as_csv(report, trials):
    names = {p.stem for p in report.tables}
    assert {"experiment1", "training", "experiment2-safe", "experiment3-n10", "summary"} <= names
    by_name = {p.stem: pd.read_csv(p, keep_default_na=False) for p in report.tables}
    assert len(by_name["summary"]) == len(trials) / 2
    ff1 = by_name["experiment1"].query("planner == 'ff1' and reading == 'flown'").iloc[0]
    assert float(ff1["paper_fuel_mean"]) == 1.906


def test_nothing_temporary_is_left_behind(report):
    files = {p for p in report.markdown.parent.rglob("*") if p.is_file()}
    assert files == {report.markdown, report.html, *report.tables, *report.figures}


def test_text_from_outside_is_shown_and_never_followed(report):
    page = report.html.read_text()
    assert "<td" in page
    assert "pairs | nodes" in page
    assert "&lt;http://example.org&gt; and [a](http://b.c)" in page


def test_the_same_results_give_the_same_bytes(report, results, tmp_path):
    def content(root):
        return {p.relative_to(root): p.read_bytes() for p in root.rglob("*") if p.is_file()}

    build_report(results, tmp_path)
    assert content(tmp_path) == content(report.markdown.parent)


def test_what_is_missing_says_which_command_fills_it(trials_at, tmp_path):
    files = build_report(Results(trials_at(6)), tmp_path)
    text = files.markdown.read_text()
    for command in ("prolearn train", "prolearn evaluate --n 2..30", *EXPERIMENTS):
        assert f"`{command}`" in text
    assert "No trial has n = 10; this section uses n = 6" in text
    assert [p.name for p in files.figures] == ["experiment1.svg", "experiment1.png"]


def test_each_optimizer_of_experiment_3_can_be_missing(report, both):
    def seeded(rows):
        return written(experiment3.section(rows, planner_styles([])))

    names, text = seeded(both)
    assert {"experiment3-n10", "experiment3-optimizers-n10", "experiment3-plain-n10"} <= names
    assert "roughly 20 s without a seed and less than 5 s" in text
    names = {path.stem for path in (*report.figures, *report.tables)}  # of the expert alone
    text = report.markdown.read_text()
    assert "experiment3-n10" in names
    assert "experiment3-plain-n10" not in names
    assert "`prolearn warmstart --optimizer plain`" in text
    names, text = seeded(both[both["optimizer"] == "plain"])
    assert "experiment3-plain-n10" in names
    assert "experiment3-n10" not in names
    assert "`prolearn warmstart`" in text


def test_captions_of_run_times_say_on_how_many_threads_they_were_taken(report):
    text = report.markdown.read_text()
    (times,) = (line for line in text.splitlines() if "Time to plan one instance" in line)
    assert "on one thread" in times
    assert "from scenario to controls on one thread" in text
    assert "| Threads" in text


def test_untimed_trials_leave_out_the_run_times(trials):
    summary = summarize(trials.assign(seconds=float("nan")))
    names, text = written(experiment2.section(summary, planner_styles(summary["planner"])))
    assert "experiment2-fuel" in names and "experiment2-seconds" not in names
    assert "No planner was timed" in text


def test_the_report_loads_no_solver_no_torch_and_no_pyplot():
    heavy = {"torch", "cvxpy", "clarabel", "mlflow", "matplotlib.pyplot"}
    code = f"import sys, pipeline.report; print(*({heavy!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
