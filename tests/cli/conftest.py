"""The command line as a person meets it: a process of its own, in a folder of its own."""

import os
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import pytest
from forked import Forked


@pytest.fixture
def prolearn(forked: Forked, tmp_path: Path) -> Callable[..., CompletedProcess[str]]:
    """Run prolearn in an empty folder; the result has returncode, stdout and stderr.

    As on a machine with one core, but where processes are asked for, whose imports take long.
    """

    def run(*arguments: object, **environment: str) -> CompletedProcess[str]:
        given = os.environ | {"COLUMNS": "80", "LOKY_MAX_CPU_COUNT": "1"} | environment
        return forked.run([str(one) for one in arguments], tmp_path, given)

    return run
