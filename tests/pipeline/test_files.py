import os
import stat
import tracemalloc
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from matplotlib.figure import Figure
from rights import bound_by_modes, read_only

from pipeline.errors import InputError
from pipeline.files import (
    make_folder,
    published,
    read_bytes,
    refuse_unwritable,
    unfinished,
    write_text,
)
from pipeline.storage.folder import open_folder


@contextmanager
def umask(wanted):
    before = os.umask(wanted)
    try:
        yield
    finally:
        os.umask(before)


def by_arrow(path):
    with published(path) as temporary:
        pq.write_table(pa.table({"n": [1]}), temporary)


def by_matplotlib(path):
    with published(path) as temporary:
        Figure().savefig(temporary, format="png")


def by_storage(path):
    open_folder(str(path.parent)).publish(path.name, b"text")


WRITERS = [lambda path: write_text(path, "text"), by_storage, by_arrow, by_matplotlib]


def mode_of(path):
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize(("mask", "mode"), [(0o077, 0o600), (0o022, 0o644), (0o002, 0o664)])
def test_a_new_file_has_the_rights_that_umask_leaves(tmp_path, write, mask, mode):
    with umask(mask):
        write(tmp_path / "new")
    assert mode_of(tmp_path / "new") == mode


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize("mode", [0o600, 0o664, 0o444])
def test_a_file_that_is_replaced_keeps_its_rights(tmp_path, write, mode):
    path = tmp_path / "old"
    path.write_text("old")
    path.chmod(mode)
    with umask(0o022):
        write(path)
    assert mode_of(path) == mode
    assert path.read_bytes() != b"old"
    assert [*tmp_path.iterdir()] == [path]


def test_what_replaces_a_private_file_is_private_while_it_is_written(tmp_path):
    path = tmp_path / "old"
    path.touch(0o600)
    with published(path) as temporary:
        temporary.write_text("secret")
        assert mode_of(temporary) == 0o600


def test_an_unfinished_file_is_known_whatever_the_name_of_the_finished_one(tmp_path):
    for name in ("plan.json", ".a", "two\nlines", "x.tmp"):
        with published(tmp_path / name) as temporary:
            assert unfinished(temporary) == tmp_path / name
        assert unfinished(tmp_path / name) is None


def test_where_a_file_can_be_written_is_known_before_and_nothing_is_made(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to(tmp_path / "locked" / "file")
    (tmp_path / "locked").mkdir()
    before = sorted(tmp_path.rglob("*"))
    refuse_unwritable(tmp_path / "file")
    refuse_unwritable(tmp_path / "new" / "folder" / "file")
    for name, what in (("file/new", "is a file"), ("file/a/b", "is a file"), ("", "is a folder")):
        with pytest.raises(InputError, match=what):
            refuse_unwritable(tmp_path / name)
    with pytest.raises(OSError, match="name too long"):
        refuse_unwritable(tmp_path / (240 * "x"))
    with read_only(tmp_path / "locked"):
        for name in ("locked/file", "locked/new/file", "link"):
            with pytest.raises(PermissionError, match=name):
                refuse_unwritable(tmp_path / name)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("folder", ["locked", "n" * 300])
def test_a_folder_that_cannot_be_looked_into_is_told_by_the_name_of_the_file(tmp_path, folder):
    (tmp_path / "locked").mkdir(mode=0)
    with bound_by_modes(), pytest.raises(OSError) as raised:
        refuse_unwritable(tmp_path / folder / "file")
    assert raised.value.filename == str(tmp_path / folder / "file")


@pytest.mark.parametrize(
    "use",
    [make_folder, refuse_unwritable, lambda path: write_text(path, ""), lambda p: read_bytes(p, 1)],
)
def test_a_url_is_no_path_and_is_named_as_it_was_given_without_its_secrets(
    use, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for url, shown in (
        ("s3://bucket/plan.json", "s3://bucket/plan.json"),
        ("git+HTTPS://x.org/a", "git+HTTPS://x.org/a"),
        ("s3://KEY:SECRET@bucket/plan.json", "s3://bucket/plan.json"),
    ):
        with pytest.raises(InputError) as refused:
            use(Path(url))
        assert str(refused.value) == f"{shown} is a URL; expected a path on this machine."
    assert list(tmp_path.iterdir()) == []
    make_folder(Path("a:b/c:"))
    write_text(tmp_path / "s3:" / "plan.json", "here")
    assert (tmp_path / "a:b" / "c:").is_dir() and Path(tmp_path, "s3:", "plan.json").is_file()


def test_reading_takes_no_more_memory_than_what_there_is_and_ends_at_the_most(tmp_path):
    small, cut = tmp_path / "small", 2**21 + 5
    small.write_bytes(b"text")
    tracemalloc.start()
    try:
        assert read_bytes(small, 2**28) == b"text"
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 2**22
    small.write_bytes(content := os.urandom(cut + 9))
    assert read_bytes(small, cut) == content[:cut]
    assert read_bytes(small, cut + 10) == content
