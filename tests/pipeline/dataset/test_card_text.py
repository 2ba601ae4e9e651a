"""What a manifest or the name of a folder says is text in the card."""

import json
import re
import shlex
from dataclasses import replace

import pyarrow.parquet as pq
import pytest
from hostile import HOSTILE, NAME, READ, assert_plain, read

from pipeline.dataset.card import write_card
from pipeline.dataset.manifest import MadeWith, read_manifest
from pipeline.documents import with_checksum
from pipeline.storage import COPY, MANIFEST
from pipeline.storage.shards import digest_of, encode


@pytest.fixture
def card(solved, monkeypatch):
    """That of a dataset by somebody who means no good, in the folder above it.

    What a manifest says is what its shards say, and settings are known ones: versions are text.
    """
    folder = solved.rename(solved.with_name(f'{NAME}"'))
    before = read_manifest(folder)
    told = MadeWith(
        *({**v, HOSTILE: HOSTILE} for v in (before.made_with.sample, before.made_with.solve))
    )
    manifest, digests = replace(before, made_with=told), {}
    for shard in manifest.expected():
        for name in (shard.scenarios, shard.solved):
            table = pq.read_table(folder / name, partitioning=None)
            content = encode(table.replace_schema_metadata(shard.metadata(name)))
            (folder / name).write_bytes(content)
            digests[name] = digest_of(content)
    document = with_checksum(replace(manifest, shards=digests).fields())
    for name in (MANIFEST, COPY):
        (folder / name).write_text(json.dumps(document))
    monkeypatch.chdir(folder.parent)
    return write_card(folder)


def test_what_a_manifest_says_is_text_in_the_card(card):
    assert_plain(card)
    text = read(card.split("---\n", 2)[2])
    assert text.count(READ) > 1


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
        assert command[command.index("--out") + 1] == "data/again"
    assert solve[:3] == ["prolearn", "solve", "data/again"]
