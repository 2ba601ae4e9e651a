"""Killed (-9) at every step of publishing, then run again: the same bytes as if undisturbed."""

import os
import select
import shutil
import signal
import time
from contextlib import suppress
from pathlib import Path

import pytest
from contents import content
from kills import run_script
from processes import SOON, workers_of

from pipeline.parallel.workers import Workers

pytestmark = pytest.mark.system

SCRIPT = """
import sys
from pathlib import Path
from kills import die_at_flush, kills
from pipeline.dataset.samples import Sample
from pipeline.dataset.making import sample
from pipeline.dataset.making import solve
from pipeline.expert import Settings
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers

SAMPLES = {2: Sample(count=3, shard_rows=2)}
root = Path(sys.argv[1])

def make(folder):
    sample(folder, SAMPLES, Problem(), workers=Workers(1))
    solve(folder, Settings(), workers=Workers(jobs=1))

def killed(step):
    die_at_flush(step)
    make(root / f"{step:03d}")

make(root / "undisturbed")
for step in kills(killed):
    make(root / f"{step:03d}")
print(step + 1)
"""


def test_killed_at_any_step_of_publishing_the_next_run_gives_the_same_bytes(tmp_path, forked):
    kills = int(run_script(forked, SCRIPT, tmp_path))
    # Scenarios, timings and plans of two shards, manifests and their copies: each is flushed
    # before and after its rename, so that every kill falls on one side of one.
    assert kills >= 20
    wanted = content(tmp_path / "undisturbed")
    assert len(wanted) == 2 + 2 + 1 + 1
    for k in range(kills):
        assert content(tmp_path / f"{k:03d}") == wanted, f"step {k}"
        assert not list((tmp_path / f"{k:03d}").rglob("*.tmp"))


SOLVE = """
import os
from pipeline.dataset.making import solve
from pipeline.progress import Progress
from pipeline.parallel.workers import Workers
from pipeline.expert import Settings

class Loud(Progress):
    def say(self, sentence):
        print(sentence, flush=True)

os.setsid()
solve({folder!r}, Settings(), workers=Workers(jobs=2, progress=Loud()))
"""


class Solve:
    """A solve by two workers, a process group of its own."""

    def __init__(self, forked, folder):
        self.output, out = os.pipe()
        with os.fdopen(out, "w") as log:
            self.process = forked.start(SOLVE.format(folder=str(folder)), Path.cwd(), log)
        self.pid = self.process.pid

    def said(self):
        """All it says, once everything that holds its output has ended, and its exit status."""
        said = [b""]
        with os.fdopen(self.output, "rb", buffering=0) as output:
            while len(said) == 1 or said[-1]:
                assert select.select([output], [], [], SOON)[0], "some process goes on"
                said.append(output.read(1 << 16))
        return b"".join(said).decode(), self.process.wait()


@pytest.fixture
def busy(tmp_path):
    """A folder with some work for two processes."""
    from pipeline.dataset.making import sample
    from pipeline.dataset.samples import Sample
    from pipeline.orbit.problem import Problem

    folder = tmp_path / "busy"
    sample(folder, {6: Sample(count=60, shard_rows=2)}, Problem(), workers=Workers(1))
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
    busy, tmp_path, forked
):
    from pipeline.dataset.making import solve
    from pipeline.expert import Settings
    from pipeline.parallel.workers import Workers

    alone = Path(shutil.copytree(busy, tmp_path / "alone"))
    solve(alone, Settings(), workers=Workers(jobs=1))
    run = Solve(forked, busy)
    assert until(lambda: list(busy.glob("n=6/part-*")))
    os.kill(run.pid, signal.SIGSTOP)  # no more work is given out, however slow this process is
    workers = workers_of(run.pid)
    assert len(workers) == 2
    os.kill(workers[0], signal.SIGKILL)
    os.kill(run.pid, signal.SIGCONT)
    said, status = run.said()
    assert status == 0
    assert "a worker process was killed" in said
    assert content(busy) == content(alone)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A folder whose shards are larger than a pipe holds, so that a worker gets them in parts."""
    from pipeline.dataset.making import sample
    from pipeline.dataset.samples import Sample
    from pipeline.orbit.problem import Problem

    folder = tmp_path_factory.mktemp("drawn") / "weighty"
    sample(folder, {30: Sample(count=160, shard_rows=80)}, Problem(), workers=Workers(1))
    assert (folder / "_scenarios/n=30/part-00000.parquet").stat().st_size > 2**17
    return folder


@pytest.fixture
def weighty(drawn, tmp_path):
    """A copy of the sampled dataset, which is not solved yet."""
    return Path(shutil.copytree(drawn, tmp_path / "weighty"))


def started(forked, folder):
    """A solve, once its first worker has appeared."""
    run = Solve(forked, folder)
    assert until(lambda: workers_of(run.pid))
    return run


def semaphores_of(pid):
    return list(Path("/dev/shm").glob(f"*loky-{pid}-*"))


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for workers in /proc")
@pytest.mark.parametrize("wait", [0.0, 0.1, 0.25])  # s: workers are importing
def test_a_kill_while_workers_are_starting_leaves_no_process_and_no_semaphore(
    weighty, wait, forked
):
    run = started(forked, weighty)
    try:
        time.sleep(wait)
        run.process.kill()
        run.said()
        assert not semaphores_of(run.pid)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(run.pid, signal.SIGKILL)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for workers in /proc")
def test_what_processes_left_that_were_killed_all_at_once_is_removed_by_the_next_run(busy, forked):
    run = started(forked, busy)
    os.killpg(run.pid, signal.SIGKILL)
    run.said()
    assert semaphores_of(run.pid)  # their tracker, which would have, was killed with them
    following = started(forked, busy)
    following.process.send_signal(signal.SIGTERM)
    following.said()
    assert not semaphores_of(run.pid)
