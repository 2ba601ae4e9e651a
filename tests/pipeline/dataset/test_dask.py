"""A real Dask scheduler with two worker processes on loopback; one is killed half way."""

import re
import signal
import subprocess
import sys
import time

import pytest

from pipeline.dataset.format.samples import Sample
from pipeline.dataset.stages.sample import sample
from pipeline.dataset.stages.solve import solve
from pipeline.expert import Settings
from pipeline.jobs.workers import Workers
from pipeline.orbit.problem import Problem
from pipeline.progress import Progress

SHARDS = 12


def started(log, module, *arguments):
    command = [sys.executable, "-m", f"distributed.cli.{module}", *arguments, "--no-dashboard"]
    with log.open("w") as file:
        return subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT)


@pytest.fixture
def cluster(tmp_path):
    """Address of a scheduler, and its two workers."""
    log = tmp_path / "scheduler.log"
    processes = [started(log, "dask_scheduler", "--host", "127.0.0.1", "--port", "0")]
    try:
        found, end = None, time.monotonic() + 30
        while not found and time.monotonic() < end:
            found = re.search(r"Scheduler at:\s+(tcp://127\.0\.0\.1:\d+)", log.read_text())
            time.sleep(0.05)
        assert found, log.read_text()
        address = found.group(1)
        for k in range(2):
            local = ["--local-directory", str(tmp_path / f"scratch{k}")]
            options = ["--nthreads", "1", "--no-nanny", *local]
            worker = started(tmp_path / f"{k}.log", "dask_worker", address, *options)
            processes.append(worker)
        yield address, processes[1:]
    finally:
        for process in processes:
            process.kill()
            process.wait()


class Killer(Progress):
    """Kills a worker once a third of the rows is done."""

    def __init__(self, worker):
        self.worker, self.shards, self.at = worker, 0, None

    def done(self, rows, note="", *, failed=0):
        self.shards += 1
        if self.shards == SHARDS // 3:
            self.worker.send_signal(signal.SIGKILL)
            self.at = self.shards


def test_a_cluster_that_loses_a_worker_gives_the_bytes_of_this_machine(cluster, tmp_path, content):
    from distributed import Client

    address, workers = cluster
    samples = {5: Sample(count=8 * SHARDS, shard_rows=8)}
    for name in ("here", "there"):
        sample(tmp_path / name, samples, Problem(), jobs=1)
    solve(tmp_path / "here", Settings(), workers=Workers(jobs=1))
    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
    killer = Killer(workers[0])
    there = Workers(scheduler=address)
    solve(tmp_path / "there", Settings(), workers=there, progress=killer)
    assert killer.at == SHARDS // 3
    assert workers[0].wait(timeout=60) == -signal.SIGKILL
    assert killer.shards == SHARDS
    assert content(tmp_path / "there") == content(tmp_path / "here")
