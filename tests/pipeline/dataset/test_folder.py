"""Folders: on this machine, in memory, by URL; full, read-only, held by another process."""

import os
import subprocess
import sys
from contextlib import contextmanager

import fsspec
import pyarrow.dataset as pads
import pytest

from pipeline.dataset.folder import open_folder
from pipeline.dataset.lock import sole_writer
from pipeline.dataset.manifest import Sample, read_manifest
from pipeline.dataset.read import examples
from pipeline.dataset.sample import sample
from pipeline.dataset.solve import solve
from pipeline.dataset.verify import repair, verify
from pipeline.dataset.workers import Workers
from pipeline.errors import InputError, ProlearnError
from pipeline.expert import Settings
from pipeline.orbit.problem import Problem

ONE = Workers(jobs=1)
SAMPLES = {2: Sample(count=7, shard_rows=3), 3: Sample(count=6, shard_rows=3, seed=5)}


@pytest.fixture
def in_memory():
    yield "memory://prolearn-test/data"
    files = fsspec.filesystem("memory")
    files.rm("/prolearn-test", recursive=True)


def test_a_dataset_in_memory_has_the_bytes_of_one_on_disk(in_memory, solved):
    sample(in_memory, SAMPLES, Problem(), jobs=1)
    solve(in_memory, Settings(), workers=Workers(jobs=2))  # workers touch no file
    files = fsspec.filesystem("memory")
    for path in [p for p in solved.rglob("*.parquet") if "_timings" not in p.parts]:
        name = path.relative_to(solved).as_posix()
        assert files.cat(f"/prolearn-test/data/{name}") == path.read_bytes()
    assert read_manifest(in_memory) == read_manifest(solved)


def test_a_dataset_in_memory_is_verified_mended_and_read(in_memory, solved):
    sample(in_memory, SAMPLES, Problem(), jobs=1)
    solve(in_memory, Settings(), workers=ONE)
    files = fsspec.filesystem("memory")
    whole = files.cat("/prolearn-test/data/n=3/part-00001.parquet")
    files.pipe("/prolearn-test/data/n=3/part-00001.parquet", whole[:-50])
    files.pipe("/prolearn-test/data/n=3/notes.txt", b"hello")
    faults = {f.path for f in verify(in_memory, workers=ONE)}
    assert faults == {"n=3/part-00001.parquet", "n=3/notes.txt"}
    repair(in_memory, workers=ONE)
    assert list(verify(in_memory, workers=ONE)) == []
    assert files.cat("/prolearn-test/data/n=3/part-00001.parquet") == whole
    assert (examples(in_memory, 2, "train").states == examples(solved, 2, "train").states).all()
    rows = pads.dataset("/prolearn-test/data/n=2", filesystem=files).count_rows()
    assert rows == 7


def test_what_is_missing_in_memory_is_said_like_on_disk(in_memory):
    with pytest.raises(InputError, match="memory://prolearn-test/data does not exist"):
        read_manifest(in_memory)
    sample(in_memory, {2: Sample(count=1)}, Problem(), jobs=1)


def test_an_s3_url_leads_to_arrow_s_own_filesystem():
    folder = open_folder("s3://bucket/some/n10?region=eu-central-1")
    assert folder.files.type_name == "s3"
    assert folder.root == "bucket/some/n10"


def test_the_secret_in_a_url_is_not_shown():
    url = "s3://key:secret@bucket/n10?region=x&scheme=http&endpoint_override=127.0.0.1%3A1"
    assert str(open_folder(url)).startswith("s3://bucket/n10")


def test_a_url_of_no_known_kind_is_refused():
    with pytest.raises(InputError, match="nowhere://x is on no known filesystem"):
        open_folder("nowhere://x")


@contextmanager
def mounted(path, options):
    """A small filesystem of its own, which only root may mount."""
    path.mkdir(exist_ok=True)
    run = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(path)],
        capture_output=True,
        text=True,
        check=False,
    )
    if run.returncode:
        pytest.skip(f"no filesystem can be mounted here: {run.stderr.strip()}")
    try:
        yield path
    finally:
        subprocess.run(["umount", str(path)], check=True)


def test_a_full_disk_gives_a_sentence_and_leaves_what_was_there(tmp_path, solved, content):
    with mounted(tmp_path / "small", "size=400k") as disk:
        folder = disk / "data"
        sample(folder, {8: Sample(count=100, shard_rows=10)}, Problem(), jobs=1)
        with pytest.raises(ProlearnError, match=r"No space left on device.*is intact: make room"):
            solve(folder, Settings(), workers=ONE)
        done = {p.name: p.read_bytes() for p in folder.glob("n=8/*")}
        assert 0 < len(done) < 10
        assert all(not name.endswith(".tmp") for name in done)
        faults = {fault.what for fault in verify(folder, workers=ONE)}
        assert faults == {"is missing"}
        subprocess.run(["mount", "-o", "remount,size=8m", str(disk)], check=True)
        solve(folder, Settings(), workers=ONE)
        assert list(verify(folder, workers=ONE)) == []
        assert all((folder / "n=8" / name).read_bytes() == done[name] for name in done)


def test_a_read_only_folder_gives_a_sentence_and_can_still_be_read(tmp_path, solved):
    import shutil

    with mounted(tmp_path / "disk", "size=8m") as disk:
        shutil.copytree(solved, disk / "data")
        (disk / "data/n=3/part-00001.parquet").unlink()
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        for write in (
            lambda: solve(disk / "data", Settings(), workers=ONE),
            lambda: sample(disk / "new", SAMPLES, Problem(), jobs=1),
            lambda: repair(disk / "data", workers=ONE),
        ):
            with pytest.raises(ProlearnError, match="cannot be written to"):
                write()
        assert [f.path for f in verify(disk / "data", workers=ONE)] == ["n=3/part-00001.parquet"]
        assert len(examples(disk / "data", 2, "train")) == 6


HOLD = """
import sys, time
from pipeline.dataset.folder import open_folder
from pipeline.dataset.lock import sole_writer
with sole_writer(open_folder(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_second_writer_is_told_who_holds_the_folder_and_a_dead_one_holds_nothing(solved):
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(solved)], stdout=subprocess.PIPE, text=True
    )
    try:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(InputError, match=rf"by process {holder.pid} on .*, since 20"):
            solve(solved, Settings(), workers=ONE)
    finally:
        holder.kill()
        holder.communicate()
    solve(solved, Settings(), workers=ONE)
    left = sorted(p.name for p in solved.iterdir() if p.is_file())
    assert left == ["_lock", "_manifest.json", "_stamps.json"]


def test_what_a_killed_writer_left_unfinished_is_swept_away_and_is_no_fault(solved):
    left = solved / "n=3" / ".part-00001.parquet.abc.tmp"
    left.write_bytes(b"half")
    assert list(verify(solved, workers=ONE)) == []
    with sole_writer(open_folder(solved)):
        assert not left.exists()
        assert str(os.getpid()) in (solved / "_writer").read_text()


def test_two_runs_without_a_lock_both_end_with_the_same_bytes(in_memory, solved):
    """Object stores have no lock: both runs do all of the work and write the same."""
    sample(in_memory, SAMPLES, Problem(), jobs=1)
    begun = fsspec.filesystem("memory").cat("/prolearn-test/data/_manifest.json")
    solve(in_memory, Settings(), workers=ONE)
    first = fsspec.filesystem("memory").cat("/prolearn-test/data/_manifest.json")
    fsspec.filesystem("memory").pipe("/prolearn-test/data/_manifest.json", begun)
    solve(in_memory, Settings(), workers=ONE)
    assert fsspec.filesystem("memory").cat("/prolearn-test/data/_manifest.json") == first
