"""A saved network's size, and the folder it is kept in where the tracking store fails."""

import json
import math
import shutil
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from safetensors import safe_open

from pipeline.errors import ProlearnError
from pipeline.files import write_text
from registry.entries import shown

WEIGHTS = "weights.safetensors"

STORY = "training.json"
"""What a kept network's run would have said."""


def parameter_count(folder: Path) -> int:
    """Numbers in a saved network's weights."""
    with safe_open(folder / WEIGHTS, framework="numpy") as weights:
        return sum(math.prod(weights.get_slice(k).get_shape()) for k in weights.keys())  # noqa: SIM118


def weights_kib(folder: Path) -> float:
    """Size of a saved network's weights, KiB."""
    return (folder / WEIGHTS).stat().st_size / 1024


def keep(folder: Path, arch: str, story: Mapping[str, Any]) -> Path:
    """Copy a saved network to ``unregistered/<arch>-<time>`` with what its run would have said.

    Args:
        folder: the network's.
        arch: its architecture.
        story: fields of ``registry.story.Story``.

    Raises:
        ProlearnError: where that cannot be written either.
    """
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
    kept = Path("unregistered").absolute() / f"{arch}-{stamp}"
    story = {**story, "params": {key: shown(value) for key, value in story["params"].items()}}
    try:
        shutil.copytree(folder, kept)
        write_text(kept / STORY, json.dumps(story, indent=1, default=str) + "\n")
    except OSError as error:
        raise ProlearnError(
            f"The trained network can neither be registered nor be kept in {kept} ({error}); "
            "expected a writable disk with space on it."
        ) from error
    return kept
