"""Folders: on this machine, in memory, by URL; full, read-only, held by another process."""

import hashlib
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from functools import partial
from http.server import BaseHTTPRequestHandler, SimpleHTTPRequestHandler, ThreadingHTTPServer
from threading import Barrier, Lock, Thread

import fsspec
import pyarrow.dataset as pads
import pytest
from contents import content
from rights import read_only, room_until_told

from pipeline.dataset.making import sample, solve
from pipeline.dataset.manifest import OWNED, read_manifest
from pipeline.dataset.reading import solved_examples
from pipeline.dataset.samples import Sample
from pipeline.dataset.verifying import repair, verify
from pipeline.errors import InputError, ProlearnError
from pipeline.expert import Settings
from pipeline.flight import montecarlo
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers
from pipeline.progress import Progress
from pipeline.storage.folder import open_folder
from pipeline.storage.ledger import sole_writer
from pipeline.storage.shared import shared

ONE = Workers(jobs=1)
SAMPLES = {2: Sample(count=7, shard_rows=3), 3: Sample(count=6, shard_rows=3, seed=5)}


def test_a_dataset_in_memory_has_the_bytes_of_one_on_disk(in_memory, solved):
    sample(in_memory, SAMPLES, Problem(), workers=ONE)
    solve(in_memory, Settings(), workers=Workers(jobs=2))  # workers touch no file
    files = fsspec.filesystem("memory")
    for path in [p for p in solved.rglob("*.parquet") if "_timings" not in p.parts]:
        name = path.relative_to(solved).as_posix()
        assert files.cat(f"/prolearn-test/data/{name}") == path.read_bytes()
    assert read_manifest(in_memory) == read_manifest(solved)


def test_a_dataset_in_memory_is_verified_mended_and_read(in_memory, solved):
    sample(in_memory, SAMPLES, Problem(), workers=ONE)
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
    there, here = (solved_examples(one, 2, "train").states for one in (in_memory, solved))
    assert (there == here).all()
    rows = pads.dataset("/prolearn-test/data/n=2", filesystem=files).count_rows()
    assert rows == 7


def test_what_is_missing_in_memory_is_said_like_on_disk(in_memory):
    with pytest.raises(InputError, match="memory://prolearn-test/data does not exist"):
        read_manifest(in_memory)
    sample(in_memory, {2: Sample(count=1)}, Problem(), workers=ONE)


@pytest.mark.parametrize("scheme", ["ftp", "http"])
def test_a_server_that_is_not_reached_is_not_said_to_lack_a_dataset(scheme):
    with pytest.raises(ProlearnError, match=rf"^{scheme}://127\.0\.0\.1:1/x is not reached \(.*C"):
        read_manifest(open_folder(f"{scheme}://127.0.0.1:1/x"))


def test_an_s3_url_leads_to_arrow_s_own_filesystem():
    folder = open_folder("s3://bucket/some/n10?region=eu-central-1")
    assert folder.files.base_fs.type_name == "s3"
    assert folder.files.base_path == "bucket/some/n10/"


def test_the_secret_in_a_url_is_not_shown():
    url = "s3://key:secret@bucket/n10?region=x&scheme=http&endpoint_override=127.0.0.1%3A1"
    assert str(open_folder(url)).startswith("s3://bucket/n10")


@pytest.mark.parametrize("url", ["memory://", "memory://prolearn-root", "memory:///prolearn/b c/"])
def test_names_are_those_inside_the_folder_wherever_it_is(url):
    folder = open_folder(url)
    try:
        for name in ("_manifest.json", "n=2/part-00000.parquet"):
            folder.publish(name, name.encode())
            assert folder.read(name) == name.encode()
            assert folder.exists(name)
        assert folder.names() == ["_manifest.json", "n=2/part-00000.parquet"]
        folder.remove("_manifest.json")
        assert folder.names() == ["n=2/part-00000.parquet"]
    finally:
        fsspec.filesystem("memory").rm("/", recursive=True)


def test_shards_in_a_folder_that_is_a_link_are_there_and_foreign_files_stay(solved, tmp_path):
    elsewhere = (solved / "n=3").rename(tmp_path / "elsewhere")
    (solved / "n=3").symlink_to(elsewhere)
    (elsewhere / "notes").write_text("mine")
    assert repair(solved, workers=ONE) == []
    (elsewhere / "part-00001.parquet").unlink()
    names = [fault.path for fault in repair(solved, workers=ONE)]
    assert names == ["n=3/part-00001.parquet"]
    assert (elsewhere / "part-00001.parquet").is_file()
    assert (elsewhere / "notes").read_text() == "mine"
    assert not (solved / "_damaged").exists()


def test_a_link_to_a_folder_of_the_dataset_brings_no_file_in_danger(solved):
    (solved / "again").symlink_to(".")
    before = content(solved)
    assert list(verify(solved, workers=ONE)) == []
    assert repair(solved, workers=ONE) == []
    assert content(solved) == before


def test_files_of_any_name_are_set_aside_once_and_hinder_no_command(solved):
    foreign = [os.fsdecode(name) for name in (b"\xff", b"\xfd/notes", b"n=3/\xfe", b"a\nb")]
    for name in foreign:
        (solved / name).parent.mkdir(exist_ok=True)
        (solved / name).write_text("mine")
    sample(solved, {4: Sample(count=1)}, Problem(), workers=ONE)
    solve(solved, Settings(), workers=ONE)
    assert {fault.path for fault in repair(solved, workers=ONE)} == {*foreign}
    assert all((solved / f"_foreign/{name}.1").read_text() == "mine" for name in foreign)
    assert list(verify(solved, workers=ONE)) == []


def test_a_relative_name_may_look_like_a_uri(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("run:1", "mailto:x"):  # Arrow ends the process at these
        folder = open_folder(name)
        assert not folder.is_present()
        folder.publish("n=2/a", b"a")
        assert (tmp_path / name / "n=2" / "a").read_bytes() == folder.read("n=2/a") == b"a"


@pytest.mark.parametrize(
    "where", [os.fsdecode(b"b\xff"), "file:///tmp/b%FF", os.fsdecode(b"file:///tmp/b\xff")]
)
def test_a_name_that_is_not_utf_8_is_refused(where):
    with pytest.raises(InputError, match="is not UTF-8; expected one that is"):
        open_folder(where)


@pytest.mark.parametrize("host", ["", "localhost", "LOCALHOST"])
def test_a_file_url_is_the_folder_on_this_machine_with_its_lock_and_its_renames(host, tmp_path):
    path = tmp_path / "my data é#1%20"
    url = f"file://{host}{path.as_uri().removeprefix('file://')}"
    assert open_folder(url) == open_folder(path)
    sample(url, {2: Sample(count=2)}, Problem(), workers=ONE)
    held = sole_writer(open_folder(path), OWNED)
    with held, pytest.raises(InputError, match=r"is being written by"):
        solve(url, Settings(), workers=ONE)
    solve(url, Settings(), workers=ONE)
    assert list(verify(path, workers=ONE)) == []
    assert (path / "_lock").exists()


@pytest.mark.parametrize("url", ["file://elsewhere/data", "file://data", "file://", "file:///a?b"])
def test_a_file_url_of_another_machine_or_of_no_path_is_refused(url):
    with pytest.raises(InputError, match=r"^file:.* expected file:///FOLDER"):
        open_folder(url)


@pytest.mark.parametrize("url", ["nowhere://x", "dir://x/y", "github://x/y", "reference://x/y"])
def test_a_url_of_no_known_kind_or_without_what_its_kind_needs_is_refused(url):
    with pytest.raises(InputError, match=f"^{url} is on no known filesystem"):
        open_folder(url)


def test_an_ftp_url_without_a_server_is_refused_in_a_sentence_alone(capfd):
    with pytest.raises(InputError, match=r"^ftp:///x names no server; expected ftp://SERVER/"):
        open_folder("ftp:///x")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("url", ["az://c/x", "abfs://c/x"])
def test_a_url_whose_package_is_not_installed_names_it(url, monkeypatch):
    monkeypatch.setitem(sys.modules, "adlfs", None)
    with pytest.raises(InputError, match=f"^{url} needs a package .*adlfs.*: install it, or"):
        open_folder(url)


def test_the_web_is_not_written_to():
    with pytest.raises(InputError, match=r"^http://127\.0\.0\.1:1/x is of a kind that cannot be"):
        open_folder("http://127.0.0.1:1/x").publish("a", b"")


@pytest.mark.parametrize("url", ["s3://bucket/n6", "S3://key:secret@bucket/n6", "gs://bucket/n6"])
def test_a_setting_in_a_url_that_arrow_does_not_know_is_named(url):
    said = "bucket/n6 is no URL that pyarrow reads .*parameter in .*: 'bogus'"
    with pytest.raises(InputError, match=said) as refused:
        open_folder(f"{url}?bogus=1")
    assert "known filesystem" not in str(refused.value)


@pytest.mark.parametrize("url", ["S3://bucket/n10?region=x", "Memory://n10"])
def test_a_scheme_may_be_in_capitals(url):
    assert open_folder(url) == open_folder(url.replace(url[:6], url[:6].lower()))


@pytest.mark.parametrize(
    ("query", "seconds"), [("", 30), ("?scheme=http&retry_limit_seconds=2", 2)]
)
def test_google_is_tried_for_half_a_minute_or_as_long_as_the_url_says(query, seconds):
    files = open_folder(f"gs://anonymous@bucket/n10{query}").files.base_fs
    _, (settings,) = files.__reduce__()
    assert settings["retry_time_limit"] == timedelta(seconds=seconds)


def test_a_dataset_on_a_web_server_is_verified(solved):
    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    serve = partial(Quiet, directory=solved)
    with ThreadingHTTPServer(("127.0.0.1", 0), serve) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        try:
            url = f"http://127.0.0.1:{server.server_port}"
            assert open_folder(url).names() == open_folder(solved).names()
            assert list(verify(url, workers=ONE)) == []
            (solved / "empty").mkdir()
            assert open_folder(f"{url}/empty").names() == open_folder(f"{url}/empty").top() == []
            with pytest.raises(InputError, match=r"/empty does not exist"):
                list(verify(f"{url}/empty", workers=ONE))
        finally:
            server.shutdown()


def test_a_server_of_s3_that_knows_no_checksums_in_the_content_gets_the_content_alone(monkeypatch):
    monkeypatch.delenv("AWS_REQUEST_CHECKSUM_CALCULATION", raising=False)
    put = {}

    class Bucket(BaseHTTPRequestHandler):
        def do_HEAD(self):
            self.send_error(404)

        def do_PUT(self):
            put[self.path] = self.rfile.read(int(self.headers["Content-Length"]))
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Bucket) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        try:
            here = f"scheme=http&endpoint_override=127.0.0.1:{server.server_port}&region=x"
            folder = open_folder(f"s3://key:word@bucket/n6?{here}&allow_delayed_open=true")
            folder.publish("notes.txt", b"all of it")
        finally:
            server.shutdown()
    assert put == {"/bucket/n6/notes.txt": b"all of it"}


class Filling(Progress):
    """The disk is full once two shards are done."""

    def __init__(self, fill):
        self.fill, self.shards = fill, 0

    def done(self, rows, note="", *, failed=0):
        self.shards += 1
        if self.shards == 2:
            self.fill()


def test_a_full_disk_gives_a_sentence_and_leaves_what_was_there(tmp_path, monkeypatch):
    # Both shards are in the manifest when the disk is full, however fast they were solved.
    monkeypatch.setattr("pipeline.storage.ledger.COMMIT_SHARE", float("inf"))
    folder = tmp_path / "data"
    sample(folder, {8: Sample(count=40, shard_rows=10)}, Problem(), workers=ONE)
    with room_until_told() as fill:
        with pytest.raises(ProlearnError, match=r"File too large.*is intact: make room"):
            solve(folder, Settings(), workers=ONE.with_progress(Filling(fill)))
        done = {p.name: p.read_bytes() for p in folder.glob("n=8/*")}
        assert len(done) == 2
        assert not list(folder.rglob("*.tmp"))
        assert {fault.what for fault in verify(folder, workers=ONE)} == {"is missing"}
    solve(folder, Settings(), workers=ONE)
    assert list(verify(folder, workers=ONE)) == []
    assert all((folder / "n=8" / name).read_bytes() == done[name] for name in done)


def test_a_read_only_folder_gives_a_sentence_and_can_still_be_read(tmp_path, solved):
    (solved / "n=3/part-00001.parquet").unlink()
    before = content(solved)
    with read_only(tmp_path):
        for write in (
            lambda: solve(solved, Settings(), workers=ONE),
            lambda: sample(tmp_path / "new", SAMPLES, Problem(), workers=ONE),
            lambda: repair(solved, workers=ONE),
        ):
            with pytest.raises(ProlearnError, match="cannot be written to"):
                write()
        assert [f.path for f in verify(solved, workers=ONE)] == ["n=3/part-00001.parquet"]
        assert len(solved_examples(solved, 2, "train")) == 6
    assert content(solved) == before


HOLD = """
import sys, time
from pipeline.storage.folder import open_folder
from pipeline.storage.ledger import sole_writer
with sole_writer(open_folder(sys.argv[1]), "n=.*"):
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
    assert left == ["_lock", "_manifest.copy.json", "_manifest.json", "_stamps.json"]


HALF = f"{'0123456789abcdef' * 2}.tmp"
"""The end of the name of an unfinished file of ours."""


def test_what_a_killed_writer_left_unfinished_is_swept_away_and_is_no_fault(solved):
    left = [
        *(solved / f"{top}n=3/.part-00001.parquet.{HALF}" for top in ("", "_scenarios/")),
        *(solved / f"_timings/{name}.{HALF}" for name in ("n=3/.part-00001.parquet",)),
        solved / f"_timings/._manifest.json.{HALF}",
        *(solved / f".{name}.{HALF}" for name in ("_manifest.json", "_writer", "README.md")),
    ]
    for path in left:
        path.write_bytes(b"half")
    assert list(verify(solved, workers=ONE)) == []
    with sole_writer(open_folder(solved), OWNED):
        assert not [path for path in left if path.exists()]
        assert str(os.getpid()) in (solved / "_writer").read_text()


def test_what_a_worker_does_for_a_client_that_has_ended_is_not_written(solved):
    folder = open_folder(solved)
    with shared(folder) as where:
        assert where.opened() == folder
        assert list(verify(solved, workers=ONE)) == []
    with pytest.raises(InputError, match=r"does not reach .* expected storage that all machines"):
        where.opened()
    assert not list(solved.rglob("*.tmp"))


def test_a_command_whose_folder_another_has_taken_over_says_so(solved):
    folder = open_folder(solved)
    told = pytest.raises(InputError, match="taken over by another command")
    # The first has no lock, as where others do not see it.
    with told, shared(folder) as where, sole_writer(folder, OWNED):
        where.opened()


OTHERS = [
    ".letter.tmp",
    ".git/.mine.tmp",
    f".git/.part-00001.parquet.{HALF}",
    f".letter.txt.{HALF}",
    "n=3/.part-00001.parquet.abc.tmp",
    f"n=3/.notes.txt.{HALF}",
    f"papers/n=3/.part-00001.parquet.{HALF}",
    f"_manifest.json.{HALF}",
]


@pytest.mark.parametrize("owned", [OWNED, montecarlo.OWNED], ids=["dataset", "flights"])
def test_unfinished_files_of_other_programs_stay(solved, owned):
    for name in OTHERS:
        (solved / name).parent.mkdir(parents=True, exist_ok=True)
        (solved / name).write_text("mine")
    with sole_writer(open_folder(solved), owned):
        assert [name for name in OTHERS if not (solved / name).exists()] == []


def test_a_writer_does_not_look_through_folders_that_are_not_its_own(tmp_path):
    """As with --out ~: what takes long is refused before anything is looked through."""
    for k in range(300):
        (tmp_path / f"{k}/{k}").mkdir(parents=True)
        (tmp_path / f"{k}/{k}/.part-00000.parquet.{HALF}").write_text("mine")
    looked = []
    sys.addaudithook(lambda event, told: looked.append(told) if event == "os.scandir" else None)
    with pytest.raises(InputError, match="holds other files"):
        sample(tmp_path, SAMPLES, Problem(), workers=ONE)
    with sole_writer(open_folder(tmp_path), OWNED):
        pass
    opened = [one for one in looked if str(tmp_path) in str(one)]
    assert len(opened) < 100
    assert len(list(tmp_path.rglob(f"*{HALF}"))) == 300


class InStep(Progress):
    """Of two runs: both list what there is to do before either does any, then shard by shard.

    One at a time, since files in memory can be read half written, which a store's cannot.
    """

    def __init__(self, turn, both):
        self.turn, self.both, self.expected, self.rows = turn, both, 0, 0

    def expect(self, rows):
        self.expected = rows
        self._wait_for_the_other()

    def done(self, rows, note="", *, failed=0):
        self.rows += rows
        self._wait_for_the_other()

    def _wait_for_the_other(self):
        self.turn.release()
        try:
            self.both.wait(timeout=60)
        finally:
            self.turn.acquire()


def test_two_runs_at_once_without_a_lock_both_end_with_the_same_bytes(in_memory, solved):
    """Object stores have no lock: both runs do all of the work and write the same."""
    sample(in_memory, SAMPLES, Problem(), workers=ONE)
    turn, both = Lock(), Barrier(2)
    watches = [InStep(turn, both), InStep(turn, both)]

    def run(watch):
        with turn:
            return solve(in_memory, Settings(), workers=ONE.with_progress(watch))

    with ThreadPoolExecutor(2) as pool:
        manifests = list(pool.map(run, watches))
    assert [(watch.expected, watch.rows) for watch in watches] == [(13, 13)] * 2
    assert manifests == [read_manifest(solved)] * 2
    files = fsspec.filesystem("memory")
    for name, digest in content(solved).items():
        assert hashlib.sha256(files.cat(f"/prolearn-test/data/{name}")).hexdigest() == digest
