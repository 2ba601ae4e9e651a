"""Commands and pieces of code, each a process forked from one that has imported everything.

Imports take several seconds, nearly all that a command takes which is refused or plans one small
swarm; so they are made once. What a command does from its first line on is the same.
"""

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import fork_client
import fork_server

PATIENCE = 120.0
"""Seconds after which a process is given up."""


class Forked:
    """Runs commands and code; a context manager."""

    def __enter__(self) -> "Forked":
        """Start the process that others are forked from."""
        self._folder = tempfile.TemporaryDirectory()
        self._socket = f"{self._folder.name}/socket"
        self._server = subprocess.Popen(
            [sys.executable, fork_server.__file__, self._socket],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        assert self._server.stdout is not None
        assert self._server.stdout.readline() == b"ready\n"
        return self

    def __exit__(self, *_: object) -> None:
        """End it, and what it runs."""
        os.killpg(self._server.pid, signal.SIGKILL)
        self._server.communicate()
        self._folder.cleanup()

    @property
    def command(self) -> list[str]:
        """``prolearn`` as a program and its first arguments, which a signal does not reach."""
        return [sys.executable, "-S", "-E", fork_client.__file__, self._socket]

    def run(
        self,
        arguments: Sequence[str],
        folder: Path,
        environment: Mapping[str, str] = os.environ,
        meanwhile: Callable[[int], object] = lambda process: None,
        code: str = "",
    ) -> "subprocess.CompletedProcess[str]":
        """Run prolearn, or code, in a folder; the result has returncode, stdout and stderr.

        While it runs, ``meanwhile`` is called with its process id.
        """
        with (
            Path(os.devnull).open() as nothing,
            tempfile.TemporaryFile("w+") as out,
            tempfile.TemporaryFile("w+") as err,
        ):
            streams = [nothing.fileno(), out.fileno(), err.fileno()]
            with fork_client.ask(
                self._socket, streams, arguments, code, folder, environment
            ) as answers:
                answers.settimeout(PATIENCE)
                process = int(answers.recv(64))
                try:
                    meanwhile(process)
                    status = int(answers.recv(64))
                except TimeoutError:
                    os.kill(process, signal.SIGKILL)
                    raise
            said = []
            for file in (out, err):
                file.seek(0)
                said.append(file.read())
            return subprocess.CompletedProcess(arguments, status, *said)
