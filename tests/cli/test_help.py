"""Help: every command has examples that can be given as they stand."""

import re
import shlex

import pytest
from typer.main import get_command

from cli.main import app


def walk(command, path=()):
    """Every command and group, by the words that call it."""
    yield path, command
    for name, one in getattr(command, "commands", {}).items():
        yield from walk(one, (*path, name))


COMMANDS = dict(walk(get_command(app)))


def examples(command):
    """The command lines after ``Example:`` or ``Examples:``."""
    _, _, after = (command.help or "").replace("Examples:", "Example:").partition("Example:")
    return [line.strip() for line in after.splitlines() if line.strip()]


@pytest.mark.parametrize("path", COMMANDS, ids=lambda path: " ".join(path) or "prolearn")
def test_every_command_has_an_example_that_parses(path):
    lines = examples(COMMANDS[path])
    assert lines
    for line in lines:
        program, *words = shlex.split(line)
        assert program == "prolearn"
        found, command = (), COMMANDS[()]
        while words and words[0] in getattr(command, "commands", {}):
            found, command = (*found, words[0]), command.commands[words.pop(0)]
        assert found[: len(path)] == path, "an example is of the command that it stands at"
        command.make_context(" ".join(found), words)  # refuses options and values that are unknown


@pytest.mark.parametrize("path", COMMANDS, ids=lambda path: " ".join(path) or "prolearn")
def test_on_80_columns_every_example_is_a_line_of_its_own(path, run):
    done = run(*path, "--help")
    assert done.returncode == 0
    shown = [line.strip() for line in done.stdout.splitlines()]
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert not re.search(r"<[\w|-]+\s", done.stdout), "choices are on one line"
    for line in examples(COMMANDS[path]):
        assert line in shown
