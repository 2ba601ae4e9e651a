"""Names that every folder of shards has, whatever its shards are of."""

MANIFEST, STAMPS = "_manifest.json", "_stamps.json"
LOCK, WRITER = "_lock", "_writer"
FOREIGN = "_foreign/"
TIMINGS = "_timings/"
