"""The report: result tables in; Markdown, one HTML page, CSV tables and figures out."""

from pipeline.report.page import ReportFiles, Results, build_report, no_rows

__all__ = ["ReportFiles", "Results", "build_report", "no_rows"]
