"""The report: Markdown, one HTML page, CSV tables and figures, written from result tables."""

import base64
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path

import pandas as pd
from markdown_it import MarkdownIt
from markdown_it.token import Token
from markupsafe import Markup

from pipeline.experiments import (
    experiment1,
    experiment2,
    experiment3,
    experiment4,
    experiment5,
    scaling,
    trainings,
)
from pipeline.experiments.averages import prepared, reference_size, summarize
from pipeline.experiments.records import NO_SEED, TABLES
from pipeline.experiments.verdicts import CHEAP, SAFE
from pipeline.figures.labels import planner_of, share
from pipeline.figures.style import planner_styles, save
from pipeline.figures.tables import Column, Picture, Section, Table, Writer, file_name, write_csv
from pipeline.figures.transfer import Example, transfer_figure
from pipeline.files import write_text
from pipeline.markup import template

TITLE = "Learned swarm transfers between passive relative orbits"

QUESTIONS = [
    *(Column("Question", "question"), Column("Verdict", "verdict")),
    *(Column("Numbers", "numbers"), Column("Best baseline", "baseline")),
]

PROVENANCE = [
    *(Column("Part", "part"), Column("Run", "run_short"), Column("Made", "made")),
    *(Column("Data", "data"), Column("Digest", "digest_short"), Column("Code", "code_short")),
    Column("Machine", "machine"),
]
NAMES = r"questions|provenance|summary|beyond|training|experiment\d(-[\w.-]+)?|transfer-\d+"
WRITTEN = re.compile(rf"tables/({NAMES})\.csv|figures/({NAMES})\.(svg|png)")
"""Paths of the tables and figures that a report writes, relative to its folder."""

DIGITS = 12  # digits of ids and digests that the page shows; the CSV file has them in full


def no_rows(table: str) -> pd.DataFrame:
    """A table of ``TABLES`` without rows."""
    return pd.DataFrame(columns=list(TABLES[table]))


@dataclass(frozen=True, eq=False)
class Results:
    """Result tables of all experiments, with the columns of TABLES; most may be empty."""

    trials: pd.DataFrame
    warmstarts: pd.DataFrame = field(default_factory=partial(no_rows, "warmstarts"))
    training: pd.DataFrame = field(default_factory=partial(no_rows, "training"))
    curves: pd.DataFrame = field(default_factory=partial(no_rows, "curves"))
    examples: Sequence[Example] = ()
    # A row for each run that a table comes from: part, run, made, data, digest, code, versions,
    # machine
    provenance: pd.DataFrame = field(default_factory=pd.DataFrame)
    notes: Sequence[str] = ()  # on parts that are left out or were made otherwise; text or Markdown
    transfer_times: pd.DataFrame = field(default_factory=partial(no_rows, "transfer_times"))
    flights: pd.DataFrame = field(default_factory=partial(no_rows, "flights"))

    @property
    def planners(self) -> set[str]:
        """Every planner that some table names."""
        tables = (self.trials, self.transfer_times, self.flights)
        named = [table["planner"] for table in tables]
        named += [self.training["arch"], self.curves["arch"]]
        return {*pd.concat(named), *map(planner_of, self.warmstarts["seed"])} - {NO_SEED}


@dataclass(frozen=True)
class ReportFiles:
    """Paths of the files of a report."""

    markdown: Path  # refers to the figures
    html: Path  # contains them
    tables: tuple[Path, ...]  # a CSV file for each table
    figures: tuple[Path, ...]  # an SVG and a PNG file for each figure


def build_report(results: Results, out: Path) -> ReportFiles:
    """Write a report: report.md, report.html, tables/ and figures/, determined by the results.

    Tables and figures of an earlier report in the folder that this one lacks are removed.
    """
    summary, n = summarize(results.trials), reference_size(results.trials)
    # One style for each planner of any table, so that it looks the same in every figure.
    styles = planner_styles(results.planners)
    sections = [
        questions(results, summary, n),
        experiment1.section(summary, n, styles),
        trainings.section(results.training, results.curves, styles),
        experiment2.section(summary, styles),
        *scaling.sections(prepared(results.trials), results.training, styles),
        experiment3.section(results.warmstarts, styles),
        experiment4.section(results.transfer_times, styles),
        experiment5.section(results.flights, styles),
        examples(results.examples),
        provenance(results.provenance),
    ]
    writer = Writer()
    markdown = "\n\n".join([f"# {TITLE}", *map(writer.write, sections)]) + "\n"
    tables, figures, drawn = [], [], {}
    for table in [*writer.tables, Table("summary", summary, [])]:
        tables.append(out / "tables" / f"{file_name(table.name)}.csv")
        write_csv(table.frame, tables[-1])
    for picture in writer.pictures:
        path = out / "figures" / file_name(picture.name)
        save(picture.figure, path)
        figures += [path.with_name(path.name + suffix) for suffix in (".svg", ".png")]
        drawn[f"figures/{path.name}.svg"] = figures[-2].read_bytes()
    page = html_page(TITLE, markdown, drawn)
    files = ReportFiles(out / "report.md", out / "report.html", tuple(tables), tuple(figures))
    earlier = {*out.glob("tables/*"), *out.glob("figures/*")} if files.markdown.exists() else set()
    write_text(files.markdown, markdown)
    write_text(files.html, page)
    for path in earlier - {*tables, *figures}:
        if WRITTEN.fullmatch(path.relative_to(out).as_posix()):
            path.unlink()
    return files


def questions(results: Results, summary: pd.DataFrame, n: int) -> Section:
    """The table of questions that opens the report, and notes on what is missing."""
    trials, training = prepared(results.trials), results.training
    alike = experiment2.trained_alike(summary, training)
    found = [
        *experiment1.findings(trials, training, n),
        *experiment2.size_findings(trials, training, n),
        *scaling.findings(scaling.larger_swarms(trials, training), training),
        *experiment2.family_findings(alike),
        *experiment2.fuel_findings(alike),
        *trainings.findings(training),
        *experiment2.time_findings(trials),
        *experiment3.findings(results.warmstarts),
        *experiment3.paper_findings(results.warmstarts),
        *experiment4.findings(results.transfer_times, training),
        *experiment5.findings(results.flights),
        *experiment1.paper_findings(summary),
    ]
    table = Table("questions", pd.DataFrame(map(asdict, found)), QUESTIONS) if found else None
    values = {"findings": table, "notes": results.notes, "safe": share(SAFE), "cheap": CHEAP}
    return Section("pipeline/report/questions.md.jinja", values)


def examples(shown: Sequence[Example]) -> Section:
    """A figure for each example transfer (the paper's Figures 1 and 9)."""
    pictures = [
        (one.title, Picture(f"transfer-{k}", transfer_figure(one)))
        for k, one in enumerate(shown, start=1)
    ]
    return Section("pipeline/experiments/examples.md.jinja", {"pictures": pictures})


def provenance(runs: pd.DataFrame) -> Section:
    """The run behind each table, where any is known."""
    table = None
    if not runs.empty:
        short = {f"{name}_short": runs[name].str[:DIGITS] for name in ("run", "digest", "code")}
        table = Table("provenance", runs.assign(**short), PROVENANCE)
    return Section("pipeline/report/provenance.md.jinja", {"runs": table})


# The page: Markdown as one self-contained HTML file.

TABLE = '<div class="table" role="region" aria-label="table" tabindex="0">\n<table>\n'
"""The opening of a table, in a box that scrolls where the window is narrow."""

FIGURE = re.compile(r"!\[(?P<label>[^]]*)\]\((?P<src>[^)]*)\)")
"""The beginning of a paragraph that is a figure; the rest of it is the caption."""

FIGURE_HTML = Markup(
    '<figure>\n<img alt="{label}" src="data:image/svg+xml;base64,{data}">\n'
    "<figcaption>{caption}</figcaption>\n</figure>\n"
)


def html_page(title: str, markdown: str, pictures: Mapping[str, bytes]) -> str:
    """The page with its pictures inlined; raw HTML, links and other images stay text."""
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    parser.disable(["link", "autolink", "image", "reference"])
    rules: dict[str, Callable[..., str]] = parser.renderer.rules  # type: ignore[attr-defined]
    rules["table_open"] = lambda *_: TABLE
    rules["table_close"] = lambda *_: "</table>\n</div>\n"
    tokens = parser.parse(markdown)
    for opened, inline, closed in zip(tokens, tokens[1:], tokens[2:], strict=False):
        opened.hidden = False  # items of lists are paragraphs of the same width as others
        found = FIGURE.match(inline.content) if opened.type == "paragraph_open" else None
        if found and found["src"] in pictures:
            caption = Markup(parser.renderInline(inline.content[found.end() :]))
            data = base64.b64encode(pictures[found["src"]]).decode()
            opened.type = inline.type = closed.type = "html_block"
            figure = FIGURE_HTML.format(label=found["label"], data=data, caption=caption)
            inline.content = str(figure)  # markup would escape what the parser appends it to
    contents = _heading_ids(tokens)
    body = parser.renderer.render(tokens, parser.options, {})
    # The body comes out of the parser, which escapes what the text contains.
    page = template("pipeline/report/page.html.jinja")
    return page.render(title=title, contents=contents, body=Markup(body))


def _heading_ids(tokens: Sequence[Token]) -> list[tuple[str, str]]:
    """Give each section heading an id, and return ids and titles in order."""
    contents = []
    for heading, inline in pairwise(tokens):
        if heading.type == "heading_open" and heading.tag == "h2":
            title = "".join(part.content for part in inline.children or ())
            name = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
            heading.attrSet("id", name)
            contents.append((name, title))
    return contents
