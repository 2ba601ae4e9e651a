"""A folder of very many shards costs as much for each as one of few."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import ClassVar

from pipeline.progress import SILENT
from pipeline.storage import ledger
from pipeline.storage.folder import open_folder
from pipeline.storage.ledger import Ledger, NewShard, read_checked


@dataclass(frozen=True)
class Listing:
    """A manifest that counts how often it is made."""

    shards: Mapping[str, str]
    made: ClassVar[list[int]] = []  # number of shards, each time

    def __post_init__(self):
        self.made.append(len(self.shards))

    def fields(self):
        return asdict(self)


def test_between_commits_no_manifest_is_made_and_a_commit_makes_one(tmp_path, monkeypatch):
    monkeypatch.setattr(ledger, "COMMIT_SHARE", 1e-9)  # none after the first, but when asked
    folder = open_folder(tmp_path / "many")
    book = Ledger(folder, Listing({}), SILENT)
    names = [f"n=2/part-{k:05d}.parquet" for k in range(200)]
    book.publish(NewShard(names[0], b"0"))
    Listing.made.clear()
    for name in names[1:]:
        book.publish(NewShard(name, name.encode()))
    for name in names:
        assert book.is_sound(name)
    book.drop(names[:50])
    assert Listing.made == []
    book.commit()
    assert Listing.made == [150]
    assert sorted(read_checked(folder, "_manifest.json")["shards"]) == names[50:]
