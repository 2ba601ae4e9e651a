"""The command line as a person meets it: a process of its own, in a folder of its own."""

import os

import pytest


@pytest.fixture
def prolearn(forked, tmp_path):
    """Run prolearn in an empty folder; the result has returncode, stdout and stderr."""

    def run(*arguments, **environment):
        given = os.environ | {"COLUMNS": "80"} | environment
        return forked.run([str(one) for one in arguments], tmp_path, given)

    return run
