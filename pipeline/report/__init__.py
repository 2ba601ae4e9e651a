"""The report: result tables in; Markdown, one HTML page, CSV tables and figures out."""

from pipeline.report.figures.transfer import figure_transfer
from pipeline.report.page import ReportFiles, build_report
from pipeline.report.results import Example, Results

__all__ = ["Example", "ReportFiles", "Results", "build_report", "figure_transfer"]
