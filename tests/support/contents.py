"""What a dataset's folder holds, in digests."""

import hashlib
from pathlib import Path

NO_CONTENT = {"_lock", "_stamps.json", "_timings", "_damaged", "_foreign"}
"""Files and folders that differ between runs which make the same."""


def content(folder: Path) -> dict[str, str]:
    """Digest of every file of a dataset that all runs make the same, taken here."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not NO_CONTENT & {*path.relative_to(folder).parts}
    }
