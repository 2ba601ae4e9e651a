"""A folder of very many shards costs as much for each as one of few."""

from pipeline.progress import SILENT
from pipeline.storage import ledger
from pipeline.storage.folder import open_folder
from pipeline.storage.ledger import Ledger, NewShard, read_checked


def test_between_commits_no_manifest_is_made_and_a_commit_makes_one(tmp_path, monkeypatch):
    made, write = [], ledger.write_checked  # number of shards in each manifest that is made

    def counting(folder, name, fields, copy=""):
        if name == "_manifest.json":
            made.append(len(fields["shards"]))
        write(folder, name, fields, copy)

    monkeypatch.setattr(ledger, "write_checked", counting)
    monkeypatch.setattr(ledger, "COMMIT_SHARE", 1e-9)  # none after the first, but when asked
    folder = open_folder(tmp_path / "many")
    book = Ledger(folder, {"schema": "test/1", "shards": {}}, SILENT)
    names = [f"n=2/part-{k:05d}.parquet" for k in range(200)]
    book.publish(NewShard(names[0], b"0"))
    made.clear()
    for name in names[1:]:
        book.publish(NewShard(name, name.encode()))
    for name in names:
        assert book.is_sound(name)
    book.drop(names[:50])
    assert made == []
    book.commit()
    assert made == [150]
    assert sorted(read_checked(folder, "_manifest.json")["shards"]) == names[50:]
