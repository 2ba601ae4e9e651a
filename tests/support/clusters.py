"""Real Dask schedulers and worker processes on loopback, which tests start and kill."""

import re
import time
from collections.abc import Callable
from pathlib import Path

from forked import Forked, Started

RUN = """
import runpy, sys
sys.argv = {argv}
runpy.run_module({argv}[0], run_name="__main__")
"""
"""A module as a program. Nothing of Dask is loaded before, so it reads its configuration."""


def until(holds: Callable[[], object], seconds: float = 60.0) -> None:
    """Wait until something holds."""
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.02)


class Cluster:
    """A scheduler, and workers of one thread each; the protocol is Dask's tcp or tls."""

    def __init__(self, forked: Forked, folder: Path, protocol: str = "tcp") -> None:
        folder.mkdir()
        self.forked, self.folder, self.started = forked, folder, list[Started]()
        self.where = ["--host", f"{protocol}://127.0.0.1"]
        self.scheduler = self.start("dask_scheduler", *self.where, "--port", "0")
        self.log, self.workers = folder / "0.log", list[Started]()
        found = re.compile(rf"Scheduler at:\s+({protocol}://127\.0\.0\.1:\d+)")
        until(lambda: found.search(self.log.read_text()))
        self.address = found.findall(self.log.read_text())[0]

    def start(self, module: str, *arguments: str) -> Started:
        """A process of one of Dask's modules, and its log."""
        argv = [f"distributed.cli.{module}", *arguments, "--no-dashboard"]
        with (self.folder / f"{len(self.started)}.log").open("w") as log:
            self.started.append(self.forked.start(RUN.format(argv=argv), Path.cwd(), log))
        return self.started[-1]

    def start_workers(self, count: int = 2) -> None:
        """Start some, which take their time to come."""
        for _ in range(count):
            scratch = ["--local-directory", str(self.folder / f"scratch{len(self.started)}")]
            options = ["--nthreads", "1", "--no-nanny", *scratch]
            self.workers.append(self.start("dask_worker", self.address, *options))

    def await_workers(self, count: int = 2) -> None:
        """Wait until so many are there."""
        from distributed import Client

        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=60)

    def connected(self) -> bool:
        """Whether all workers that were started have found their scheduler, by their logs."""
        logs = [self.folder / f"{self.started.index(worker)}.log" for worker in self.workers]
        return all("Starting established connection" in log.read_text() for log in logs)

    def await_call(self) -> None:
        """Wait until a call is in the hands of a worker."""
        from distributed import Client

        with Client(self.address, set_as_default=False) as client:
            until(lambda: any(client.processing().values()))

    def kill_workers(self) -> None:
        """Kill all, at once."""
        for worker in self.workers:
            kill(worker)
        self.workers = []

    def start_scheduler_again(self) -> None:
        """Start another at the same address."""
        port = self.address.rpartition(":")[2]
        self.scheduler = self.start("dask_scheduler", *self.where, "--port", port)

    def end(self) -> None:
        """Kill whatever still runs."""
        for process in self.started:
            kill(process)


def kill(process: Started) -> None:
    """Kill a process (-9) and wait for its end."""
    process.kill()
    process.wait()
