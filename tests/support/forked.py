"""Commands and pieces of code, each a process forked from one that has imported everything.

Imports take several seconds, nearly all that a command takes which is refused or plans one small
swarm; so they are made once. What a command does from its first line on is the same.
"""

import fcntl
import os
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import fork_client
import fork_server

PATIENCE = 120.0
"""Seconds after which a process is given up."""


@dataclass(frozen=True)
class Started:
    """A process that goes on, as ``subprocess.Popen`` has it."""

    pid: int
    answers: socket.socket  # on which its exit status comes

    def send_signal(self, number: int) -> None:
        """Send it a signal, where it has not ended."""
        with suppress(ProcessLookupError):
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)

    def wait(self) -> int | None:
        """Wait until it has ended; the first time, its exit status."""
        with self.answers:
            return int(self.answers.recv(64)) if self.answers.fileno() >= 0 else None


class Forked:
    """Runs commands and code; a context manager. Those with the same folder share one process."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder or Path(tempfile.mkdtemp())
        self._socket = str(self._folder / "socket")

    def __enter__(self) -> "Forked":
        """Start the process that others are forked from, where nobody has; it ends with its users.

        Users are those who can write into a pipe that it reads from.
        """
        self._folder.mkdir(exist_ok=True)
        pipe = self._folder / "users"
        with suppress(FileExistsError):
            os.mkfifo(pipe)
        self._use = os.open(pipe, os.O_RDWR)
        fcntl.flock(self._use, fcntl.LOCK_EX)
        if not Path(self._socket).exists():
            with open(os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)) as users:  # noqa: PTH123 (a pipe)
                subprocess.run(
                    [sys.executable, fork_server.__file__, self._socket],
                    stdin=users,
                    stdout=subprocess.DEVNULL,
                    start_new_session=True,
                    check=True,
                )
        fcntl.flock(self._use, fcntl.LOCK_UN)
        return self

    def __exit__(self, *_: object) -> None:
        """Use it no more."""
        os.close(self._use)

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

    def start(self, code: str, folder: Path, log: TextIO) -> Started:
        """Run code in a folder until it ends or is killed; what it says goes into a file."""
        with Path(os.devnull).open() as nothing:
            streams = [nothing.fileno(), log.fileno(), log.fileno()]
            answers = fork_client.ask(self._socket, streams, code=code, folder=folder)
        answers.settimeout(PATIENCE)
        return Started(int(answers.recv(64)), answers)
