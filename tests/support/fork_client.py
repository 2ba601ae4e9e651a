"""``prolearn`` run by the fork server: ``python -S -E fork_client.py SOCKET ARGUMENT...``"""

import json
import os
import socket
import sys
from collections.abc import Mapping, Sequence


def ask(
    path: str,
    streams: Sequence[int],
    arguments: Sequence[str] = (),
    code: str = "",
    folder: os.PathLike[str] | None = None,
    environment: Mapping[str, str] = os.environ,
) -> socket.socket:
    """A connection on which the process id and then the exit status come."""
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    connection.connect(path)
    asked = {
        "arguments": list(arguments),
        "code": code,
        "folder": str(folder or os.getcwd()),  # noqa: PTH109 (pathlib is slow to import)
        "environment": dict(environment),
    }
    socket.send_fds(connection, [json.dumps(asked).encode()], streams)
    return connection


if __name__ == "__main__":
    with ask(sys.argv[1], [0, 1, 2], sys.argv[2:]) as answers:
        answers.recv(64)
        status = int(answers.recv(64))
    sys.exit(status if status >= 0 else 128 - status)
