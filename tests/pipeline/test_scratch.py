"""Temporary folders: gone at the end, and gone after a kill once the next one is made.

What is killed is a real process; the kills come before one system call after the other, as Python's
audit hooks see them.
"""

import json
import os
import tempfile
import threading
from contextlib import suppress
from pathlib import Path

import pytest
from forked import Forked
from kills import run_script

from pipeline.scratch import PREFIX, clear_scratch, scratch_folder, temporary_files_in

pytestmark = pytest.mark.system

KILLED_AT_EACH_CALL = """
import json, os, sys, tempfile
from pathlib import Path
from forked import Forked
from kills import die, kills, run_again
from pipeline.scratch import scratch_folder

CALLS = {"open", "fcntl.flock", "os.mkdir", "os.remove", "os.rmdir", "os.scandir"}
left = []

def work():
    with scratch_folder() as folder:
        (folder / "deep").mkdir()
        (folder / "deep" / "file").write_text("content")

def killed(step):
    calls = 0
    def hook(event, arguments):
        nonlocal calls
        if event in CALLS:
            calls += 1
            if calls > step:
                die()
    sys.addaudithook(hook)
    work()

work()
for step in kills(killed):
    left.append(os.listdir(tempfile.gettempdir()))
    if step % 2 == 0:  # every other time two are left for the next to find
        run_again(work)
run_again(work)
print(json.dumps([left, os.listdir(tempfile.gettempdir())]))
"""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for temporary files that nobody else uses."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", None)
    return folder


def test_killed_before_any_call_of_the_system_nothing_is_left_once_the_next_is_made(
    place: Path, forked: Forked
):
    left, at_last = json.loads(run_script(forked, KILLED_AT_EACH_CALL))
    assert len(left) > 10
    assert any(not name.endswith(".lock") for names in left for name in names)
    assert at_last == []


def test_a_folder_that_is_in_use_stays_while_others_are_cleared(place: Path, forked: Forked):
    with scratch_folder() as folder:
        (folder / "mine").write_text("content")
        code = "from pipeline.scratch import scratch_folder\nwith scratch_folder(): pass"
        assert forked.run([], Path.cwd(), code=code).returncode == 0
        clear_scratch()
        assert (folder / "mine").read_text() == "content"
        assert folder.stat().st_mode & 0o777 == 0o700
    assert list(place.iterdir()) == []


def test_a_folder_is_gone_where_its_block_fails(place: Path):
    with pytest.raises(ZeroDivisionError), scratch_folder():
        1 / 0  # noqa: B018
    assert list(place.iterdir()) == []


def test_a_thread_that_still_writes_there_keeps_neither_the_folder_nor_the_interrupt(place: Path):
    def write(folder: Path) -> None:
        with suppress(FileNotFoundError):
            for k in range(1000):
                (folder / f"{k}").touch()

    with pytest.raises(KeyboardInterrupt), scratch_folder() as folder:
        writing = threading.Thread(target=write, args=[folder])
        writing.start()
        while not (folder / "100").exists():
            pass
        raise KeyboardInterrupt
    writing.join()
    assert not list(place.iterdir())


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="needs to be root")
def test_what_another_user_left_in_a_shared_folder_is_left_alone(place: Path):
    name = f"{PREFIX}{'0' * 32}"
    (place / name).mkdir()
    (place / f"{name}.lock").touch()
    (place / f"{PREFIX}{'1' * 32}.lock").symlink_to("/etc/passwd")
    os.lchown(place / f"{PREFIX}{'1' * 32}.lock", 65534, 65534)
    os.chown(place / f"{name}.lock", 65534, 65534)
    before = sorted(place.iterdir())
    with scratch_folder():
        pass
    assert sorted(place.iterdir()) == before
    os.chown(place / f"{name}.lock", 0, 0)
    clear_scratch()
    assert not (place / name).exists()


def test_what_another_machine_has_in_a_folder_that_shows_no_locks_of_others_stays(place: Path):
    name = f"prolearn-scratch-another-{'0' * 32}"
    (place / name).mkdir()
    (place / f"{name}.lock").touch()
    clear_scratch()
    assert (place / name).is_dir() and (place / f"{name}.lock").exists()


def test_libraries_make_their_temporary_files_where_they_are_told_to(place: Path):
    with scratch_folder() as folder:
        with temporary_files_in(folder), tempfile.NamedTemporaryFile() as file:
            assert Path(file.name).parent == folder
        assert tempfile.gettempdir() == str(place)
