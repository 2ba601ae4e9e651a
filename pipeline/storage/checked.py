"""JSON documents of a folder that have a checksum, and a copy to mend them by."""

import json
from collections.abc import Mapping
from typing import Any

from pipeline.documents import parsed, with_checksum, without_checksum
from pipeline.storage.folder import Folder


def write_checked(folder: Folder, name: str, fields: Mapping[str, Any], copy: str = "") -> None:
    """Write a document with its checksum, whole, and then its copy if it shall have one."""
    content = (json.dumps(with_checksum(fields), indent=1) + "\n").encode()
    for one in filter(None, (name, copy)):
        folder.publish(one, content)


def read_checked(folder: Folder, name: str) -> dict[str, Any]:
    """The fields of a document, without its checksum.

    Raises:
        OSError: where it cannot be read.
        ValueError: where it is no JSON object or its checksum is wrong.
    """
    fields = parsed(folder.read(name))
    if not isinstance(fields, dict):
        raise ValueError("it is no JSON object")
    return without_checksum(fields)
