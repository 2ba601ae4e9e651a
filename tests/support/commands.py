"""Commands, each a process of its own, forked from one that has imported everything.

Imports take several seconds, nearly all that a command takes which is refused or plans one small
swarm; so they are made once. What a command does from its first line on is the same.
"""

import json
import os
import select
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

SERVER = """
import atexit, importlib, json, os, pkgutil, sys, threading, traceback
import cli.main, cli.stages

for module in pkgutil.iter_modules(cli.stages.__path__, "cli.stages."):
    importlib.import_module(module.name)
print("ready", flush=True)
for line in sys.stdin:
    child = os.fork()
    if child == 0:
        break
    print(child, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
else:
    sys.exit()
asked = json.loads(line)
os.environ.clear()
os.environ.update(asked["environment"])
os.chdir(asked["folder"])
for number, path, flags in (
    (0, os.devnull, os.O_RDONLY),
    (1, asked["stdout"], os.O_WRONLY),
    (2, asked["stderr"], os.O_WRONLY),
):
    os.dup2(os.open(path, flags), number)
sys.argv[1:] = asked["arguments"]
status = 0
try:
    cli.main.app()
except SystemExit as end:
    status = end.code or 0
except BaseException:
    status = 1
    traceback.print_exc()
# All that an interpreter does at its end but for taking every module apart, which takes seconds.
threading._shutdown()
atexit._run_exitfuncs()
sys.stdout.flush()
sys.stderr.flush()
os._exit(status)
"""

PATIENCE = 120.0
"""Seconds after which a command is given up."""


class Commands:
    """Runs commands one after the other; a context manager."""

    def __init__(self) -> None:
        self._server = self._started()

    def __enter__(self) -> "Commands":
        """Nothing; it runs already."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self._end()

    def _started(self) -> subprocess.Popen[str]:
        """A server that has imported everything."""
        server = subprocess.Popen(
            [sys.executable, "-c", SERVER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
            start_new_session=True,
        )
        assert _heard(server) == "ready"
        return server

    def _end(self) -> None:
        """End the server, and the command that it runs."""
        os.killpg(self._server.pid, signal.SIGKILL)
        self._server.communicate()

    def run(
        self,
        arguments: list[str],
        folder: Path,
        environment: Mapping[str, str],
        meanwhile: Callable[[int], object] = lambda process: None,
    ) -> subprocess.CompletedProcess[str]:
        """Run prolearn in a folder; the result has returncode, stdout and stderr.

        While it runs, ``meanwhile`` is called with its process id.
        """
        with tempfile.TemporaryDirectory() as scratch:
            told = {name: Path(scratch) / name for name in ("stdout", "stderr")}
            for path in told.values():
                path.touch()
            asked = {
                "arguments": arguments,
                "folder": str(folder),
                "environment": dict(environment),
                **{name: str(path) for name, path in told.items()},
            }
            print(json.dumps(asked), file=self._server.stdin)
            try:
                meanwhile(int(_heard(self._server)))
                status = int(_heard(self._server))
            except subprocess.TimeoutExpired:
                self._end()
                self._server = self._started()
                raise
            return subprocess.CompletedProcess(
                arguments, status, *(path.read_text() for path in told.values())
            )


def _heard(server: subprocess.Popen[str]) -> str:
    """The next line that a server says."""
    assert server.stdout is not None
    if not select.select([server.stdout], [], [], PATIENCE)[0]:
        raise subprocess.TimeoutExpired("prolearn", PATIENCE)
    return server.stdout.readline().rstrip()
