"""Shards of tables in a folder or behind a URL, the book that names them, and a lock."""
