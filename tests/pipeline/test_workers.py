import functools
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from joblib.externals.loky import process_executor
from sentences import Sentences

from pipeline.parallel.workers import Workers


def process(task, content):
    """Where a task was done."""
    return os.getpid()


@pytest.mark.parametrize(("tasks", "here"), [(1, True), (2, False)])
def test_a_task_alone_is_done_without_another_process(tasks, here):
    done = dict(Workers(2).work(process, range(tasks), lambda task: b""))
    assert done.keys() == set(range(tasks))
    assert (set(done.values()) == {os.getpid()}) == here


def test_files_of_the_current_folder_are_no_modules_of_workers(forked, tmp_path):
    for name in ("joblib", "numpy", "random"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit")
    given = ["sample", "--n", "2", "--count", "4", "--rows-per-shard", "1", "--out", "data"]
    done = forked.run([*given, "--jobs", "2"], tmp_path)
    assert done.returncode == 0, done.stderr
    assert all(line.startswith("sampling: ") for line in done.stderr.splitlines()), done.stderr


kept: list[bytes] = []


def grow(task, content):
    """Keep 16 MB in this process, which loky looks at after each task and ends above 30 MB more.

    Otherwise it looks each second and ends it above 300 MB.
    """
    process_executor._MEMORY_LEAK_CHECK_DELAY = 0.0
    process_executor._MAX_MEMORY_LEAK_SIZE = 30_000_000
    kept.append(b"x" * 16_000_000)
    return os.getpid()


def test_workers_that_grow_are_replaced_without_a_word(recwarn):
    done = dict(Workers(2).work(grow, range(7), lambda task: b""))
    assert done.keys() == set(range(7))
    assert len(set(done.values())) > 2
    assert not recwarn.list


def sent():
    """Bytes written by this process so far; Linux adds those of a write at its end."""
    counts = Path("/proc/self/io").read_text()
    return int(counts.split("wchar: ")[1].split()[0])


def kill_when_sending(before):
    """Kill this process as soon as it has sent the length of a result, before the result itself."""
    while sent() == before:
        pass
    os.kill(os.getpid(), signal.SIGKILL)


def die_while_sending(marker, task, _):
    """Return the task; at the first attempt, be killed while sending a long result instead."""
    if task == 0 and not marker.exists():
        marker.touch()
        threading.Thread(target=kill_when_sending, args=[sent()], daemon=True).start()
        return b"x" * 100_000_000
    return task


@pytest.mark.skipif(not Path("/proc/self/io").exists(), reason="counts what was sent as Linux does")
def test_a_worker_killed_while_it_sends_a_result_costs_a_sentence(tmp_path):
    progress = Sentences()
    function = functools.partial(die_while_sending, tmp_path / "died")
    done = dict(Workers(2, progress=progress).work(function, range(8), lambda task: b""))
    assert done == {task: task for task in range(8)}
    (sentence,) = progress.said
    assert sentence.startswith("a worker process was killed")


GIVEN_UP = """
from functools import partial
from joblib.externals.loky import process_executor
from pipeline.parallel.processes import run_in_processes

hand_out = process_executor._ExecutorManagerThread.add_call_item_to_queue

def late(thread):  # as where the call that is next was cancelled meanwhile
    if thread.is_shutting_down():
        raise KeyError(1)
    hand_out(thread)

process_executor._ExecutorManagerThread.add_call_item_to_queue = late
results = run_in_processes((partial(pow, k, 2) for k in range(1000)), 2)
next(results)
results.close()
print("closed")
"""


def test_results_that_are_given_up_end_without_a_traceback_or_a_warning():
    root = Path(__file__).parents[2]
    done = subprocess.run(
        [sys.executable, "-c", GIVEN_UP], capture_output=True, text=True, cwd=root, timeout=120
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "closed\n", "")
