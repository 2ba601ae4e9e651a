"""The report written out: Markdown, one self-contained HTML page, tables and figures."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import jinja2

from pipeline.exhibits.blocks import Block, Picture, Section, Table
from pipeline.exhibits.style import save
from pipeline.experiments.averages import reference_size, summarize
from pipeline.files import write_text
from pipeline.report.html import html_page
from pipeline.report.questions import questions_section
from pipeline.report.results import Results
from pipeline.report.sections import all_sections

TITLE = "Learned swarm transfers between passive relative orbits"


@dataclass(frozen=True)
class ReportFiles:
    """Where a report lies.

    Attributes:
        markdown: report.md, which refers to the figures.
        html: report.html, which contains them.
        tables: one CSV file for each table.
        figures: an SVG and a PNG file for each figure.
    """

    markdown: Path
    html: Path
    tables: tuple[Path, ...]
    figures: tuple[Path, ...]


def build_report(results: Results, out: Path) -> ReportFiles:
    """Write the report of some results; the same results give the same bytes.

    Args:
        results: what the experiments left.
        out: folder for report.md, report.html, tables/ and figures/; made where it is missing.

    Returns:
        The files written, each of which appears whole.
    """
    summary = summarize(results.trials)
    n = reference_size(results.trials)
    sections = [questions_section(results, summary, n), *all_sections(results, summary, n)]
    blocks = [b for s in sections for b in s.blocks]
    tables = [_write_table(b, out) for b in blocks if isinstance(b, Table)]
    summary_file = out / "tables" / "summary.csv"
    write_text(summary_file, summary.to_csv(index=False, lineterminator="\n"))
    figures = [path for b in blocks if isinstance(b, Picture) for path in _write_figure(b, out)]
    markdown = _markdown(sections)
    page = html_page(TITLE, markdown, out)
    files = ReportFiles(
        out / "report.md", out / "report.html", (*tables, summary_file), tuple(figures)
    )
    write_text(files.markdown, markdown)
    write_text(files.html, page)
    return files


def _markdown(sections: Sequence[Section]) -> str:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("pipeline.report", ""),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    numbers = {Table: count(1), Picture: count(1)}

    def written(block: Block) -> str:
        if isinstance(block, str):
            return block
        k = next(numbers[type(block)])
        if isinstance(block, Table):
            return f"*Table {k}. {block.caption}*\n\n{block.markdown()}"
        return f"![Figure {k}](figures/{block.name}.svg)\n*Figure {k}. {block.caption}*"

    shown = [(s.title, [written(b) for b in s.blocks]) for s in sections]
    template = environment.get_template("report.md.jinja")
    return template.render(title=TITLE, sections=shown)


def _write_table(table: Table, out: Path) -> Path:
    path = out / "tables" / f"{table.name}.csv"
    write_text(path, table.frame.to_csv(index=False, lineterminator="\n"))
    return path


def _write_figure(picture: Picture, out: Path) -> tuple[Path, Path]:
    path = out / "figures" / picture.name
    save(picture.figure, path)
    return path.with_name(path.name + ".svg"), path.with_name(path.name + ".png")
