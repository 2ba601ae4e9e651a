"""Temporary folders: gone at the end, and gone after a kill once the next one is made.

What is killed is a real process; the kills come before one system call after the other, as Python's
audit hooks see them.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from pipeline.scratch import PREFIX, clear_scratch, scratch_folder, temporary_files_in

pytestmark = pytest.mark.system

KILLED_AT_EACH_CALL = """
import json, os, signal, sys, tempfile
from pathlib import Path
from pipeline.scratch import scratch_folder

CALLS = {"open", "fcntl.flock", "os.mkdir", "os.remove", "os.rmdir", "os.scandir"}

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
                os.kill(os.getpid(), signal.SIGKILL)
    sys.addaudithook(hook)
    work()

def in_a_child(work, *given):
    child = os.fork()
    if child == 0:
        try:
            work(*given)
        except BaseException as error:
            print(repr(error), file=sys.stderr, flush=True)
            os._exit(9)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

work()
left, statuses = [], []
while not statuses or statuses[-1] == -signal.SIGKILL:
    statuses.append(in_a_child(killed, len(statuses)))
    left.append(sorted(path.name for path in Path(tempfile.gettempdir()).iterdir()))
    if len(statuses) % 2:  # every other time two are left for the next to find
        assert in_a_child(work) == 0
assert in_a_child(work) == 0
print(json.dumps([statuses, left, os.listdir(tempfile.gettempdir())]))
"""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for temporary files that nobody else uses."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", None)
    return folder


def test_killed_before_any_call_of_the_system_nothing_is_left_once_the_next_is_made(place: Path):
    code = [sys.executable, "-c", KILLED_AT_EACH_CALL]
    run = subprocess.run(code, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    statuses, left, at_last = json.loads(run.stdout)
    assert statuses[-1] == 0 and set(statuses[:-1]) == {-signal.SIGKILL}
    assert len(statuses) > 10
    assert any(not name.endswith(".lock") for names in left for name in names)
    assert at_last == []


def test_a_folder_that_is_in_use_stays_while_others_are_cleared(place: Path):
    with scratch_folder() as folder:
        (folder / "mine").write_text("content")
        code = "from pipeline.scratch import scratch_folder\nwith scratch_folder(): pass"
        subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
        clear_scratch()
        assert (folder / "mine").read_text() == "content"
        assert folder.stat().st_mode & 0o777 == 0o700
    assert list(place.iterdir()) == []


def test_a_folder_is_gone_where_its_block_fails(place: Path):
    with pytest.raises(ZeroDivisionError), scratch_folder():
        1 / 0  # noqa: B018
    assert list(place.iterdir()) == []


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


def test_libraries_make_their_temporary_files_where_they_are_told_to(place: Path):
    with scratch_folder() as folder:
        with temporary_files_in(folder), tempfile.NamedTemporaryFile() as file:
            assert Path(file.name).parent == folder
        assert tempfile.gettempdir() == str(place)
