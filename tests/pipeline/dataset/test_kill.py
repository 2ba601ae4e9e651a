"""Killed (-9) at every step of publishing, then run again: the same bytes as if undisturbed.

One process imports everything and forks a child for each step, since imports take longest.
"""

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from contextlib import suppress
from pathlib import Path

import pytest
from processes import SOON, workers_of

pytestmark = pytest.mark.system

SCRIPT = """
import json, os, signal, sys
from pathlib import Path
from pipeline.dataset.format.samples import Sample
from pipeline.dataset.stages.sample import sample
from pipeline.dataset.stages.solve import solve
from pipeline.jobs.workers import Workers
from pipeline.expert import Settings
from pipeline.orbit.problem import Problem

SAMPLES = {2: Sample(count=3, shard_rows=2)}

def make(folder):
    sample(folder, SAMPLES, Problem(), jobs=1)
    solve(folder, Settings(), workers=Workers(jobs=1))

def dies_at(step):
    # The system call, not our code, is where the process ends.
    real, left = os.fsync, [step]
    def fsync(handle):
        left[0] -= 1
        if left[0] < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return real(handle)
    os.fsync = fsync

def in_a_child(work):
    child = os.fork()
    if child == 0:
        try:
            work()
        except BaseException as error:
            print(repr(error), file=sys.stderr, flush=True)
            os._exit(9)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

root = Path(sys.argv[1])
make(root / "undisturbed")  # here, so that children find everything imported
step, statuses = 0, []
while True:
    folder = root / f"{step:03d}"
    def killed():
        dies_at(step)
        make(folder)
    statuses.append(in_a_child(killed))
    if statuses[-1] != -signal.SIGKILL:
        break
    statuses.append(in_a_child(lambda: make(folder)))
    step += 1
print(json.dumps(statuses))
"""


def make_killed(root):
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(root)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


def test_killed_at_any_step_of_publishing_the_next_run_gives_the_same_bytes(tmp_path, content):
    statuses = make_killed(tmp_path)
    assert statuses[-1] == 0  # the first run that no kill reached
    kills, reruns = statuses[:-1:2], statuses[1::2]
    assert set(kills) == {-signal.SIGKILL}
    assert set(reruns) == {0}
    # Scenarios, timings and plans of two shards, manifests and their copies: each is flushed
    # before and after its rename, so that every kill falls on one side of one.
    assert len(kills) >= 20
    wanted = content(tmp_path / "undisturbed")
    assert len(wanted) == 2 + 2 + 1 + 1
    for k in range(len(kills)):
        assert content(tmp_path / f"{k:03d}") == wanted, f"step {k}"
        assert not list((tmp_path / f"{k:03d}").rglob("*.tmp"))


SOLVE = textwrap.dedent("""
    import sys
    from pipeline.dataset.stages.solve import solve
    from pipeline.progress import Progress
    from pipeline.jobs.workers import Workers
    from pipeline.expert import Settings

    class Loud(Progress):
        def say(self, sentence):
            print(sentence, flush=True)

    solve(sys.argv[1], Settings(), workers=Workers(jobs=2), progress=Loud())
""")


@pytest.fixture
def busy(tmp_path):
    """A folder with some work for two processes."""
    from pipeline.dataset.format.samples import Sample
    from pipeline.dataset.stages.sample import sample
    from pipeline.orbit.problem import Problem

    folder = tmp_path / "busy"
    sample(folder, {6: Sample(count=120, shard_rows=2)}, Problem(), jobs=1)
    return folder


def until(holds, seconds=30.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if holds():
            return True
        time.sleep(0.005)
    return False


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for workers in /proc")
def test_a_killed_worker_costs_a_sentence_and_the_run_goes_on_to_the_same_bytes(
    busy, tmp_path, content
):
    import shutil

    from pipeline.dataset.stages.solve import solve
    from pipeline.expert import Settings
    from pipeline.jobs.workers import Workers

    alone = Path(shutil.copytree(busy, tmp_path / "alone"))
    solve(alone, Settings(), workers=Workers(jobs=1))
    run = subprocess.Popen(
        [sys.executable, "-c", SOLVE, str(busy)], stdout=subprocess.PIPE, text=True
    )
    assert until(lambda: list(busy.glob("n=6/part-*")))
    os.kill(run.pid, signal.SIGSTOP)  # no more work is given out, however slow this process is
    workers = workers_of(run.pid)
    assert len(workers) == 2
    os.kill(workers[0], signal.SIGKILL)
    os.kill(run.pid, signal.SIGCONT)
    said, _ = run.communicate(timeout=60)
    assert run.returncode == 0
    assert "a worker process was killed" in said
    assert content(busy) == content(alone)


@pytest.fixture
def weighty(tmp_path):
    """A folder whose shards are larger than a pipe holds, so that a worker gets them in parts."""
    from pipeline.dataset.format.samples import Sample
    from pipeline.dataset.stages.sample import sample
    from pipeline.orbit.problem import Problem

    folder = tmp_path / "weighty"
    sample(folder, {30: Sample(count=320, shard_rows=80)}, Problem(), jobs=1)
    assert (folder / "_scenarios/n=30/part-00000.parquet").stat().st_size > 2**17
    return folder


def started(folder):
    """A solve of its own process group, once its first worker has appeared."""
    run = subprocess.Popen(
        [sys.executable, "-c", SOLVE, str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    assert until(lambda: workers_of(run.pid))
    return run


def semaphores_of(pid):
    return list(Path("/dev/shm").glob(f"*loky-{pid}-*"))


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for workers in /proc")
@pytest.mark.parametrize("wait", [0.0, 0.1, 0.25])  # s: workers are importing
def test_a_kill_while_workers_are_starting_leaves_no_process_and_no_semaphore(weighty, wait):
    run = started(weighty)
    try:
        time.sleep(wait)
        run.kill()
        run.communicate(timeout=SOON)  # until all that hold its output have ended
        assert not semaphores_of(run.pid)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(run.pid, signal.SIGKILL)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for workers in /proc")
def test_what_processes_left_that_were_killed_all_at_once_is_removed_by_the_next_run(busy):
    run = started(busy)
    os.killpg(run.pid, signal.SIGKILL)
    run.communicate(timeout=SOON)
    assert semaphores_of(run.pid)  # their tracker, which would have, was killed with them
    following = started(busy)
    following.terminate()
    following.communicate(timeout=SOON)
    assert not semaphores_of(run.pid)
