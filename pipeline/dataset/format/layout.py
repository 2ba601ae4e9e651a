"""Where everything lies in the folder of a dataset, beside what any folder of shards has.

FOLDER/n=10/part-00000.parquet               solved instances
FOLDER/_scenarios/n=10/part-00000.parquet    the scenarios they come from
FOLDER/README.md                             the card, for people and dataset hubs
FOLDER/.git/, FOLDER/.gitattributes, ...     of tools that keep the folder; left alone
"""

import re

from pipeline.storage.layout import DAMAGED, FOREIGN, LOCK, TIMINGS, WRITTEN

CARD = "README.md"
SCENARIOS = "_scenarios/"

SHARD = re.compile(rf"({SCENARIOS}|{TIMINGS})?n=\d+/part-\d{{5,}}\.parquet")
"""Names of shards."""

OWNED = rf"{SHARD.pattern}|{re.escape(CARD)}"
"""Pattern of the names of files that a dataset's writers make."""

BESIDE = re.compile(rf"{WRITTEN}|{LOCK}|({FOREIGN}|{DAMAGED}).*|{re.escape(CARD)}|\..*")
"""Names of files that a dataset may hold beside its shards."""

TOP = re.compile(rf"{BESIDE.pattern}|n=\d+|{SCENARIOS}?|{TIMINGS}?|{FOREIGN}?|{DAMAGED}?")
"""Names of files and folders right inside the folder of a dataset."""
