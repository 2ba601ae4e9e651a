import os
import stat
from contextlib import contextmanager

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from matplotlib.figure import Figure

from pipeline.files import published, write_text
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
