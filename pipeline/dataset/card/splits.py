"""Which files hold which split, as dataset hubs have it: a file belongs to one split alone."""

from collections.abc import Iterable, Sequence

from pipeline.dataset.card.contents import File
from pipeline.scenario import SPLITS

HUB_NAMES = dict(zip(SPLITS, ("train", "validation", "test"), strict=True))
"""Names of our splits on hubs."""


def files_by_split(files: Sequence[File]) -> dict[str, list[File]]:
    """Files by the hub's name of the split that their rows are of.

    Splits that have a file in common go together, under their names joined, such as
    ``validation_test``: so a split is there whole, or not by itself.
    """
    held = {file.shard.solved: file.shard.sample.splits_of(file.shard.number) for file in files}
    found: dict[str, list[File]] = {}
    for group in _joined(held.values()):
        name = "_".join(HUB_NAMES[split] for split in SPLITS if split in group)
        found[name] = [file for file in files if held[file.shard.solved] <= group]
    return found


def _joined(sets: Iterable[set[str]]) -> list[set[str]]:
    """The finest partition of the splits in which each set lies in one part, in order."""
    parts: list[set[str]] = []
    for one in sets:
        apart = [part for part in parts if not part & one]
        parts = [*apart, one.union(*(part for part in parts if part & one))]
    return sorted(parts, key=lambda part: min(map(SPLITS.index, part)))
