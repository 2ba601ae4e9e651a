"""The report written out: Markdown, one self-contained HTML page, tables and figures."""

from dataclasses import dataclass
from pathlib import Path

from pipeline.exhibits.blocks import Picture, Table, write_csv
from pipeline.exhibits.sections import Writer
from pipeline.exhibits.style import save, styles
from pipeline.experiments.ablations.section import section as ablations
from pipeline.experiments.beyond.section import sections as beyond
from pipeline.experiments.examples.section import section as examples
from pipeline.experiments.experiment1.section import section as experiment1
from pipeline.experiments.experiment2.section import section as experiment2
from pipeline.experiments.experiment3.section import section as experiment3
from pipeline.experiments.experiment4.section import section as experiment4
from pipeline.experiments.experiment5.section import section as experiment5
from pipeline.experiments.summary import prepared, reference_size, summarize
from pipeline.experiments.trainings.section import section as trainings
from pipeline.files import write_text
from pipeline.report.html import html_page
from pipeline.report.provenance import section as provenance
from pipeline.report.questions import section as questions
from pipeline.report.results import Results

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
    summary, n = summarize(results.trials), reference_size(results.trials)
    # One style for each planner of any table, so that it looks the same in every figure.
    look = styles(results.planners)
    sections = [
        questions(results, summary, n),
        experiment1(summary, n, look),
        trainings(results.training, results.curves, look),
        experiment2(summary, look),
        *beyond(prepared(results.trials), results.training, look),
        experiment3(results.warmstarts, look),
        experiment4(results.transfer_times, look),
        experiment5(results.flights, look),
        ablations(results.ablations, look),
        examples(results.examples),
        provenance(results.provenance),
    ]
    writer = Writer()
    markdown = "\n\n".join([f"# {TITLE}", *map(writer.write, sections)]) + "\n"
    tables = [_write_table(table, out) for table in [*writer.tables, Table("summary", summary, [])]]
    figures = [path for picture in writer.pictures for path in _write_figure(picture, out)]
    drawn = {f"figures/{picture.file}.svg": picture for picture in writer.pictures}
    pictures = {name: (out / name).read_bytes() for name in drawn}
    page = html_page(TITLE, markdown, pictures)
    files = ReportFiles(out / "report.md", out / "report.html", tuple(tables), tuple(figures))
    write_text(files.markdown, markdown)
    write_text(files.html, page)
    return files


def _write_table(table: Table, out: Path) -> Path:
    path = out / "tables" / f"{table.file}.csv"
    write_csv(table.frame, path)
    return path


def _write_figure(picture: Picture, out: Path) -> tuple[Path, Path]:
    path = out / "figures" / picture.file
    save(picture.figure, path)
    return path.with_name(path.name + ".svg"), path.with_name(path.name + ".png")
