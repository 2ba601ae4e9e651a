"""The front matter of a dataset's card: what hubs and the ``datasets`` library read, as YAML."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import pyarrow as pa
import yaml

from pipeline.dataset.manifest import Shard
from pipeline.dataset.schema import SOLVED_FIELDS
from pipeline.scenario import SPLITS

HUB_NAMES = dict(zip(SPLITS, ("train", "validation", "test"), strict=True))  # of our splits on hubs
DEFAULT = "default"  # the configuration that is loaded where none is named: all swarm sizes
# Hubs' categories of size, with the number of rows that each stays below
SIZES = {"n<1K": 1e3, "1K<n<10K": 1e4, "10K<n<100K": 1e5, "100K<n<1M": 1e6, "1M<n<10M": 1e7}
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


@dataclass(frozen=True)
class File:
    """The file of a shard, with its number of rows and its bytes on disk and as an Arrow table."""

    shard: Shard
    rows: int
    stored: int
    in_memory: int


def files_by_split(files: Sequence[File]) -> dict[str, list[File]]:
    """Files by the hub's name of the split of their rows; hubs give a file to one split alone.

    Splits that have a file in common go together, under their names joined, such as
    ``validation_test``: so a split is there whole, or not by itself.
    """
    held = {file.shard.solved: file.shard.sample.splits_of(file.shard.number) for file in files}
    found: dict[str, list[File]] = {}
    for group in _partition(held.values()):
        name = "_".join(HUB_NAMES[split] for split in SPLITS if split in group)
        found[name] = [file for file in files if held[file.shard.solved] <= group]
    return found


def _partition(sets: Iterable[set[str]]) -> list[set[str]]:
    """The finest partition of the splits in which each set lies in one part, in order."""
    parts: list[set[str]] = []
    for one in sets:
        apart = [part for part in parts if not part & one]
        parts = [*apart, one.union(*(part for part in parts if part & one))]
    return sorted(parts, key=lambda part: min(map(SPLITS.index, part)))


def front_matter(files: Sequence[File], title: str, licence: str) -> str:
    """The front matter as YAML, without the lines of dashes around it."""
    rows = sum(file.rows for file in files)
    return yaml.safe_dump(
        {
            "license": licence,
            "pretty_name": title,
            "task_categories": ["robotics"],
            "tags": TAGS,
            "size_categories": [next((k for k, below in SIZES.items() if rows < below), LARGEST)],
            "configs": _configurations(files),
            "dataset_info": [_info(files)],
        },
        sort_keys=False,
        allow_unicode=True,
        width=100,
    )


def _configurations(files: Sequence[File]) -> list[Mapping[str, Any]]:
    """All files, and those of each swarm size where there are several."""
    by_n = {f"n{n}": some for n, some in _by_size(files)}
    every = {DEFAULT: files} | (by_n if len(by_n) > 1 else {})
    found = {name: files_by_split(some).items() for name, some in every.items()}
    paths = {k: [{"split": s, "path": list(_paths(f))} for s, f in v] for k, v in found.items()}
    return [{"config_name": name, "data_files": data} for name, data in paths.items()]


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
    """Types as hubs call them: Arrow's name, but for float64, which Arrow calls double."""
    key, kind = "dtype", field.type
    if pa.types.is_list(kind):
        key, kind = "list", kind.value_type
    return {"name": field.name, key: "float64" if pa.types.is_float64(kind) else str(kind)}
