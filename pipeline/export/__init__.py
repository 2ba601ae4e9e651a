"""Plans as files that other tools read: orbit ephemeris messages, and tables."""

from pipeline.export.ephemeris import write_ephemerides
from pipeline.export.tables import write_csv, write_parquet

__all__ = ["write_csv", "write_ephemerides", "write_parquet"]
