"""Solved shards as the manifest has them: whatever differs from it is refused."""

from collections.abc import Iterable, Sequence

import pyarrow as pa

from pipeline.dataset.format.manifest import Manifest, Shard
from pipeline.errors import InputError
from pipeline.storage.folder import Folder
from pipeline.storage.shards import has_metadata
from pipeline.storage.sound import sound_table


def refuse_unsolved(folder: Folder, manifest: Manifest, shards: Iterable[Shard]) -> None:
    """Refuse shards that are not solved yet.

    Raises:
        InputError: naming the first one.
    """
    for shard in shards:
        if shard.solved not in manifest.shards:
            raise InputError(
                f"{folder} is not solved at n={shard.n} ({shard.solved}); run "
                f"`prolearn solve {folder}` first."
            )


def solved_table(
    folder: Folder, manifest: Manifest, shard: Shard, columns: Sequence[str] | None = None
) -> pa.Table:
    """The rows of a solved shard, or some of their columns.

    Raises:
        InputError: where it cannot be read, has another digest than the manifest gives it, or was
            made with other settings than the manifest has.
    """
    name = shard.solved
    try:
        table = sound_table(folder, name, manifest.shards[name], shard.most, columns)
        if not has_metadata(table, shard.metadata(name)):
            raise InputError("was made with other settings than the manifest has")
    except InputError as error:
        raise InputError(
            f"{name} in {folder} {error}; mend the dataset with `prolearn verify {folder} "
            "--repair`."
        ) from error
    return table
