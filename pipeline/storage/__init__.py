"""Parquet shards in a folder or behind a URL, the manifest that lists them, and a lock.

Every folder of shards, whatever they hold, is laid out as

    FOLDER/KEY=VALUE/part-00000.parquet            a shard
    FOLDER/_timings/KEY=VALUE/part-00000.parquet   how long its rows took
    FOLDER/_timings/_manifest.json                 the SHA-256 of every shard of timings
    FOLDER/_manifest.json                          the SHA-256 of every shard
    FOLDER/_manifest.copy.json                     a copy of it, in case it is damaged
    FOLDER/_stamps.json                            size and mtime of each shard when last checked
    FOLDER/_damaged/                               damaged files that were replaced
    FOLDER/_foreign/                               files that did not belong there
    FOLDER/_lock, FOLDER/_writer                   lock of the process that writes, and its name

Readers of Parquet folders skip names that begin with an underscore.
"""

import re

MANIFEST, COPY, STAMPS = "_manifest.json", "_manifest.copy.json", "_stamps.json"
LOCK, WRITER = "_lock", "_writer"
TIMINGS, TIMED = "_timings/", "_timings/_manifest.json"
FOREIGN, DAMAGED = "_foreign/", "_damaged/"

PLACES = ("", "*=*/", "_*/", "_*/*=*/")  # patterns of the folders that writers put files into
# Pattern of the files that writers make besides the shards
WRITTEN = "|".join(map(re.escape, (MANIFEST, COPY, STAMPS, WRITER, TIMED)))
