"""The command line as a person meets it: a process of its own, in a folder of its own."""

import os
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import pytest
from forked import Forked
from typer.testing import CliRunner

from cli.main import app


@pytest.fixture
def prolearn(forked: Forked, tmp_path: Path) -> Callable[..., CompletedProcess[str]]:
    """Run prolearn in an empty folder; the result has returncode, stdout and stderr.

    As on a machine with one core, but where processes are asked for, whose imports take long.
    """

    def run(*arguments: object, **environment: str) -> CompletedProcess[str]:
        given = os.environ | {"COLUMNS": "80", "LOKY_MAX_CPU_COUNT": "1"} | environment
        return forked.run([str(one) for one in arguments], tmp_path, given)

    return run


@pytest.fixture
def run(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Callable[..., CompletedProcess[str]]:
    """Run prolearn as ``prolearn`` does, but in this process.

    This is for what a command says and writes, in which a process of its own has no part. What a
    library writes past Python's streams counts as well.
    """

    def command(*arguments: object, **environment: str) -> CompletedProcess[str]:
        asked = [str(one) for one in arguments]
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(tmp_path)
            for name, value in ({"COLUMNS": "80", "LOKY_MAX_CPU_COUNT": "1"} | environment).items():
                patch.setenv(name, value)
            done = CliRunner().invoke(app, asked)
        if not isinstance(done.exception, SystemExit | None):
            raise done.exception
        written = capfd.readouterr()
        said = done.stdout + written.out, done.stderr + written.err
        return CompletedProcess(asked, done.exit_code, *said)

    return command
