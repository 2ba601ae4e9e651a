"""Pieces of code, each run in a process of its own that may be killed.

They are forked from one process that has imported everything, since imports take seconds.
"""

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

SERVER = """
import json, os, sys, tempfile, traceback
import cli.stages.tune, cli.stages.train, optuna, registry.models

for line in sys.stdin:
    asked = json.loads(line)
    child = os.fork()
    if child == 0:
        os.environ.clear()
        os.environ.update(asked["environment"])
        os.chdir(asked["folder"])
        tempfile.tempdir = None
        try:
            exec(asked["code"], {})
        except BaseException:
            traceback.print_exc()
            os._exit(9)
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""

PATIENCE = 120.0
"""Seconds after which a child is given up."""


class Children:
    """Runs pieces of code one after the other; a context manager."""

    def __enter__(self) -> "Children":
        """Start the process that they are forked from."""
        self._server = subprocess.Popen(
            [sys.executable, "-c", SERVER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
            start_new_session=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        os.killpg(self._server.pid, signal.SIGKILL)
        self._server.communicate()

    def run(self, code: str, folder: Path, environment: Mapping[str, str] = os.environ) -> int:
        """Run code in a folder; 0, or the signal that killed it as a negative number."""
        asked = {"code": code, "folder": str(folder), "environment": dict(environment)}
        print(json.dumps(asked), file=self._server.stdin)
        assert self._server.stdout is not None
        assert select.select([self._server.stdout], [], [], PATIENCE)[0], "no answer"
        return int(self._server.stdout.readline())
