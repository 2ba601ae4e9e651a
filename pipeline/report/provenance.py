"""Where results come from."""

import pandas as pd

from pipeline.exhibits.blocks import Column, Table
from pipeline.exhibits.sections import Section

DIGITS = 12
"""Digits of ids and digests that the page shows; the CSV file has them in full."""

COLUMNS = [
    Column("Part", "part"),
    Column("Run", "run_short"),
    Column("Made", "made"),
    Column("Data", "data"),
    Column("Digest", "digest_short"),
    Column("Code", "code_short"),
    Column("Machine", "machine"),
]


def section(provenance: pd.DataFrame) -> Section:
    """The run behind each table, where any is known."""
    if provenance.empty:
        return Section("pipeline/report/provenance.md.jinja", {"runs": None})
    frame = provenance.assign(
        **{f"{name}_short": provenance[name].str[:DIGITS] for name in ("run", "digest", "code")}
    )
    runs = Table("provenance", frame, COLUMNS)
    return Section("pipeline/report/provenance.md.jinja", {"runs": runs})
