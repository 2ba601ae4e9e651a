"""Manifests that somebody has changed, with a checksum that is right."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pipeline.documents import CHECKSUM, with_checksum
from pipeline.storage import COPY, MANIFEST


def forge(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change the manifest of a folder, and its copy likewise."""
    document = json.loads((folder / MANIFEST).read_text())
    del document[CHECKSUM]
    change(document)
    for name in (MANIFEST, COPY):
        (folder / name).write_text(json.dumps(with_checksum(document)))


def remove(folder: Path) -> None:
    """Remove the manifest of a folder and its copy."""
    for name in (MANIFEST, COPY):
        (folder / name).unlink()
