"""What a manifest or the name of a folder says is text in the card."""

import json
import re
import shlex

import pytest
from hostile import HOSTILE, NAME, READ, SEEN, assert_plain, read

from pipeline.dataset.card.card import write_card
from pipeline.storage.layout import MANIFEST


@pytest.fixture
def card(solved, monkeypatch):
    """That of a dataset by somebody who means no good, in the folder above it."""
    folder = solved.rename(solved.with_name(f'{NAME}"'))
    path = folder / MANIFEST
    manifest = json.loads(path.read_text())
    for one in manifest["samples"].values():
        one["family"] = HOSTILE
    manifest["solve"] |= {HOSTILE: HOSTILE, "solver": HOSTILE}
    for versions in manifest["made_with"].values():
        versions[HOSTILE] = HOSTILE
    path.write_text(json.dumps(manifest))
    monkeypatch.chdir(folder.parent)
    return write_card(folder)


def test_what_a_manifest_says_is_text_in_the_card(card):
    assert_plain(card)
    text = read(card.split("---\n", 2)[2])
    # settings 3, versions 3, the family in the list, and in two rows of draws
    assert text.count(READ) == 9


def test_the_snippets_read_a_folder_of_any_name(card):
    _, snippet = re.findall(r"```python\n(.*?)```", card, re.DOTALL)
    names = {}
    exec(snippet, names)
    assert len(names["rows"]) == 13


def test_the_commands_are_commands_of_ours_whatever_they_quote(card):
    (block,) = re.findall(r"```\n(prolearn.*?)\n```", card, re.DOTALL)
    sample, again, solve = map(shlex.split, block.splitlines())
    for command in (sample, again):
        assert command[:2] == ["prolearn", "sample"]
        assert command[command.index("--family") + 1] == SEEN
    assert solve[:3] == ["prolearn", "solve", "data/again"]
    assert solve[solve.index("--solver") + 1] == SEEN
