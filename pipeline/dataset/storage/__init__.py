"""Datasets at rest: Parquet shards in a folder or behind a URL, their manifest, and a lock."""
