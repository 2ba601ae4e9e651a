"""Names that every folder of shards has, whatever its shards are of.

    FOLDER/KEY=VALUE/part-00000.parquet            a shard
    FOLDER/_timings/KEY=VALUE/part-00000.parquet   how long its rows took
    FOLDER/_timings/_manifest.json                 the digest of every shard of timings
    FOLDER/_manifest.json                          the digest of every shard
    FOLDER/_manifest.copy.json                     the same, should that one be damaged
    FOLDER/_stamps.json                            when each shard was last known to have its digest
    FOLDER/_damaged/                               damaged files that others took the place of
    FOLDER/_foreign/                               what was there and did not belong there
    FOLDER/_lock, FOLDER/_writer                   held by the one who writes, and who that is

Readers of Parquet folders pass over names that begin with an underscore.
"""

import re

MANIFEST, COPY, STAMPS = "_manifest.json", "_manifest.copy.json", "_stamps.json"
LOCK, WRITER = "_lock", "_writer"
TIMINGS, TIMED = "_timings/", "_timings/_manifest.json"
FOREIGN, DAMAGED = "_foreign/", "_damaged/"

PLACES = ("", "*=*/", "_*/", "_*/*=*/")
"""Patterns of the folders that writers put files into."""

WRITTEN = "|".join(map(re.escape, (MANIFEST, COPY, STAMPS, WRITER, TIMED)))
"""Pattern of the names of files beside the shards that writers put there."""
