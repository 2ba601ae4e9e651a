"""The front matter of a card: what dataset hubs and the ``datasets`` library read, as YAML."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

import pyarrow as pa
import yaml

from pipeline.dataset.card.contents import Contents, File
from pipeline.dataset.card.splits import files_by_split
from pipeline.dataset.format.schema import SOLVED_FIELDS

DEFAULT = "default"
"""The configuration that is loaded where none is named: all swarm sizes."""

SIZES = {"n<1K": 1e3, "1K<n<10K": 1e4, "10K<n<100K": 1e5, "100K<n<1M": 1e6, "1M<n<10M": 1e7}
"""Hubs' categories of size, with the number of rows that each stays below."""

LARGEST = "10M<n<100M"

TAGS = [
    "astrodynamics",
    "spacecraft",
    "formation-flying",
    "swarm",
    "trajectory-optimization",
    "motion-planning",
    "convex-optimization",
]


def front_matter(contents: Contents, title: str, licence: str) -> str:
    """The front matter as YAML, without the lines of dashes around it."""
    files = contents.files
    return yaml.safe_dump(
        {
            "license": licence,
            "pretty_name": title,
            "task_categories": ["robotics"],
            "tags": TAGS,
            "size_categories": [_size(len(contents.rows))],
            "configs": [_config(name, some) for name, some in _configurations(files).items()],
            "dataset_info": [_info(files)],
        },
        sort_keys=False,
        allow_unicode=True,
        width=100,
    )


def _size(rows: int) -> str:
    return next((name for name, below in SIZES.items() if rows < below), LARGEST)


def _configurations(files: Sequence[File]) -> Mapping[str, Sequence[File]]:
    """All files, and those of each swarm size where there are several."""
    by_n = {f"n{n}": some for n, some in _by_size(files)}
    return {DEFAULT: files} | (by_n if len(by_n) > 1 else {})


def _config(name: str, files: Sequence[File]) -> Mapping[str, Any]:
    splits = files_by_split(files).items()
    data = [{"split": split, "path": list(_paths(some))} for split, some in splits]
    return {"config_name": name, "data_files": data}


def _paths(files: Sequence[File]) -> Iterator[str]:
    """Names of files, or one pattern for all of a swarm size."""
    for n, some in _by_size(files):
        every = len(some) == some[0].shard.sample.shards
        yield from [f"n={n}/*.parquet"] if every else [file.shard.solved for file in some]


def _by_size(files: Sequence[File]) -> Iterator[tuple[int, list[File]]]:
    for n, some in groupby(files, key=lambda file: file.shard.n):
        yield n, list(some)


def _info(files: Sequence[File]) -> Mapping[str, Any]:
    return {
        "config_name": DEFAULT,
        "features": [_feature(field) for field in SOLVED_FIELDS],
        "splits": [
            {
                "name": split,
                "num_bytes": sum(file.in_memory for file in some),
                "num_examples": sum(file.rows for file in some),
            }
            for split, some in files_by_split(files).items()
        ],
        "download_size": sum(file.stored for file in files),
        "dataset_size": sum(file.in_memory for file in files),
    }


def _feature(field: pa.Field) -> Mapping[str, str]:
    if pa.types.is_list(field.type):
        return {"name": field.name, "list": _dtype(field.type.value_type)}
    return {"name": field.name, "dtype": _dtype(field.type)}


def _dtype(kind: pa.DataType) -> str:
    """As hubs call it: Arrow's name, but for float64."""
    return "float64" if pa.types.is_float64(kind) else str(kind)
