"""Where everything lies in the folder of a dataset.

    FOLDER/n=10/part-00000.parquet                solved instances
    FOLDER/_scenarios/n=10/part-00000.parquet     the scenarios they come from
    FOLDER/_timings/n=10/part-00000.parquet       how long each took
    FOLDER/_manifest.json                         settings, versions, the digest of every shard
    FOLDER/_stamps.json                           when each shard was last known to have it
    FOLDER/_foreign/                              what was there and did not belong there
    FOLDER/_lock, FOLDER/_writer                  held by the one who writes, and who that is
    FOLDER/README.md                              the card, for people and dataset hubs
    FOLDER/.git/, FOLDER/.gitattributes, ...      of tools that keep the folder; left alone

Readers of Parquet folders pass over names that begin with an underscore.
"""

import re

from pipeline.storage.layout import FOREIGN, LOCK, MANIFEST, STAMPS, TIMINGS, WRITER

CARD = "README.md"
SCENARIOS = "_scenarios/"

BOOKS = re.compile(rf"{MANIFEST}|{STAMPS}|{LOCK}|{WRITER}|{FOREIGN}.*|{re.escape(CARD)}|\..*")
"""Names of files that a dataset may hold beside its shards."""

OURS = re.compile(rf"{BOOKS.pattern}|({SCENARIOS}|{TIMINGS})?n=\d+/part-\d{{5,}}\.parquet")
"""Names of all files that a dataset may hold."""
