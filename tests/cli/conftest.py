"""The command line as a person meets it: a process of its own, in a folder of its own."""

import os
import subprocess
import sys

import pytest


@pytest.fixture
def prolearn(tmp_path):
    """Run prolearn in an empty folder; the result has returncode, stdout and stderr."""

    def run(*arguments, **environment):
        return subprocess.run(
            [sys.executable, "-c", "from cli.main import app; app()", *map(str, arguments)],
            cwd=tmp_path,
            env=os.environ | {"COLUMNS": "80"} | environment,
            capture_output=True,
            text=True,
            timeout=120,
        )

    return run
