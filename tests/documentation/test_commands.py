"""Every `prolearn` command that README and docs show is one: its options and values are read."""

import re
import shlex
from pathlib import Path

import pytest
import typer

from cli.main import app

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^(?:```|~~~)\w*\n(.*?)^(?:```|~~~)", re.DOTALL | re.MULTILINE)


def commands_of(page):
    """The commands that a page shows, in their order."""
    for block in BLOCK.findall(page.read_text(encoding="utf-8")):
        for line in block.replace("\\\n", " ").splitlines():
            if line.removeprefix("$ ").startswith("prolearn ") and "-completion" not in line:
                yield line.removeprefix("$ ").strip()


COMMANDS = sorted(
    {*(line for page in PAGES if page.name != "commands.md" for line in commands_of(page))}
)


def anchors(page):
    """Those of a page's headings, as GitHub makes them."""
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", one.strip().lower()).replace(" ", "-") for one in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_to_headings_work_on_github_too(page):
    for file, anchor in re.findall(r"\]\(([\w./-]*)#([\w-]+)\)", page.read_text("utf-8")):
        target = page.parent / file if file else page
        assert target.suffix != ".md" or anchor in anchors(target), f"{file}#{anchor}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_of_a_page_do_not_refuse_what_those_before_have_written(page):
    """As a new scenario in place of another, or trials in a folder of trials with other errors."""
    made = {}
    for words in (shlex.split(line, comments=True) for line in commands_of(page)):
        if page.name != "commands.md" and words[1:3] == ["scenario", "new"]:
            assert made.setdefault(words[3], words) is words
        elif page.name != "commands.md" and words[1] == "fly" and "--trials" in words:
            folder = words[words.index("--out") + 1] if "--out" in words else f"{words[2]}-flown"
            errors = [words[k + 1] for k, word in enumerate(words) if word.startswith("--error")]
            assert made.setdefault(folder, errors) == errors, words


def parse(arguments):
    """Read a command line as it would be read, and run nothing."""
    command, parent = typer.main.get_command(app), None
    while getattr(command, "commands", {}) and not arguments[0].startswith("-"):
        parent = command.make_context(command.name, list(arguments), parent=parent)
        _, command, arguments = command.resolve_command(parent, list(arguments))
    command.make_context(command.name, list(arguments), parent=parent)


@pytest.mark.parametrize("line", COMMANDS)
def test_it_can_be_read(line):
    words = shlex.split(line, comments=True)[1:]
    ends = [k for k, word in enumerate(words) if word in (">", "|")]
    parse(words[: ends[0]] if ends else words)


def test_a_command_that_is_none_is_noticed():
    with pytest.raises(Exception, match="No such option"):
        parse(["train", "--architecture", "ff1"])
