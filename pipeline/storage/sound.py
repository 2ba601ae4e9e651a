"""Shards read from a folder, whose bytes must be what the manifest says."""

from collections.abc import Sequence

import pyarrow as pa

from pipeline.errors import InputError
from pipeline.storage.folder import Folder
from pipeline.storage.shards import Size, decode, digest_of


def sound_table(
    folder: Folder, name: str, digest: str, most: Size, columns: Sequence[str] | None = None
) -> pa.Table:
    """The rows of a shard, or some of their columns.

    The whole file is read, since a digest is that of all its bytes.

    Args:
        folder: where it is.
        name: of the file.
        digest: SHA-256 that the manifest gives it.
        most: what it may hold.
        columns: to read, or all.

    Raises:
        InputError: where it cannot be read or has another digest; what is wrong with it alone.
    """
    try:
        content = folder.read(name)
    except OSError as error:
        raise InputError(f"cannot be read ({folder.told(error)})") from error
    if digest_of(content) != digest:
        raise InputError("does not have the digest that the manifest gives it")
    return decode(content, most, columns)
