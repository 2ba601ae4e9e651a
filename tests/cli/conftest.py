"""The command line as a person meets it: a process of its own, in a folder of its own."""

import os

import pytest
from commands import Commands


@pytest.fixture(scope="session")
def commands():
    """What runs commands, without the imports of each."""
    with Commands() as found:
        yield found


@pytest.fixture
def prolearn(commands, tmp_path):
    """Run prolearn in an empty folder; the result has returncode, stdout and stderr."""

    def run(*arguments, **environment):
        given = os.environ | {"COLUMNS": "80"} | environment
        return commands.run([str(one) for one in arguments], tmp_path, given)

    return run
