"""Plotly's 3-D bundle, which is not ours and lies unchanged in ``vendor``."""

import base64
import gzip
from pathlib import Path

VENDOR = Path(__file__).with_name("vendor")


def bundle() -> bytes:
    """The bundle as published."""
    return (VENDOR / "plotly-gl3d.min.js").read_bytes()


def licence() -> str:
    """The licence that copies of it must carry."""
    return (VENDOR / "LICENSE").read_text(encoding="utf-8")


def packed(content: bytes) -> str:
    """Bytes as gzip in base64, for ``DecompressionStream`` to unpack; the same for the same."""
    return base64.b64encode(gzip.compress(content, mtime=0)).decode()
