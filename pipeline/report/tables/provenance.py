"""Table of where results come from."""

import pandas as pd

from pipeline.report.blocks import Column, Table


def facts_table(facts: pd.DataFrame) -> Table:
    """What the results were made from and with."""
    columns = [Column("Fact", "fact"), Column("Value", "value")]
    return Table("provenance", "Where these results come from.", facts, columns)
