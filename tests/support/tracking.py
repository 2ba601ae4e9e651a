"""MLflow's own servers on loopback, of a store in a folder."""

import os
import signal
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from clusters import until
from forked import Forked, Started

SERVE = """
import os, runpy, sys
import mlflow.server
from mlflow.cli import cli

def run(command, extra_env, **_):
    os.environ.update(extra_env)
    for name in [*sys.modules]:
        if name.startswith("mlflow.server"):
            del sys.modules[name]
    sys.argv = command[2:]
    runpy.run_module(sys.argv[0], run_name="__main__")

os.setsid()
mlflow.server._exec_cmd = run
cli()
"""
"""Script that runs MLflow's command line as the leader of a process group.

The server runs in the same process, not in a new interpreter; its modules are imported again, since
they read the environment as they are imported.
"""


@contextmanager
def serve(
    forked: Forked, folder: Path, port: int, command: str, *options: str
) -> Iterator[Started]:
    """Run ``mlflow server`` or ``mlflow ui`` with one worker until the end of the block."""
    asked = (command, "--backend-store-uri", "sqlite:///mlflow.db", "--workers", "1", *options)
    with Path(os.devnull).open("w") as nothing:
        process = forked.start(SERVE, folder, nothing, [*asked, "--port", str(port)])
    try:
        until(lambda: not process.runs() or answers(f"http://127.0.0.1:{port}/health"), 120.0)
        assert process.runs(), "it did not start"
        yield process
    finally:
        end(process)


def answers(url: str) -> bool:
    """Whether a server does."""
    with suppress(OSError):
        urllib.request.urlopen(url, timeout=1).close()
        return True
    return False


def end(process: Started) -> None:
    """Kill a server and its workers."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
