"""Table of where results come from."""

import pandas as pd

from pipeline.exhibits.blocks import Column, Table

DIGITS = 12
"""Digits of ids and digests that the page shows; the CSV file has them in full."""


def provenance_table(provenance: pd.DataFrame) -> Table:
    """The run behind each table; trainings are in the CSV file, the page has their versions."""
    frame = provenance.assign(
        **{f"{name}_short": provenance[name].str[:DIGITS] for name in ("run", "digest", "code")}
    )
    columns = [
        Column("Part", "part"),
        Column("Run", "run_short"),
        Column("Made", "made"),
        Column("Data", "data"),
        Column("Digest", "digest_short"),
        Column("Code", "code_short"),
        Column("Machine", "machine"),
    ]
    caption = (
        "The run that each table comes from. Experiments have the digest of the whole dataset, "
        "trainings that of the rows that they were trained on. Versions are in the CSV file."
    )
    return Table("provenance", caption, frame, columns)
