"""A process that has imported everything and forks one for each request on a Unix socket.

The command returns when it serves; it goes on until no one can write into its stdin.

A request is one packet: the environment, the folder, and a command's arguments or a piece of code,
with stdin, stdout and stderr as file descriptors. The answers are the process id and the exit
status, negative for a signal.
"""

import atexit
import ctypes
import gc
import importlib
import json
import os
import pkgutil
import select
import shutil
import signal
import socket
import sys
import tempfile
import threading
import traceback
import weakref
from contextlib import chdir, suppress
from functools import cache
from pathlib import Path
from typing import Any

LATE = (
    "cli.main",
    "alembic.command",
    "alembic.config",
    "encodings.cp437",
    "git",
    "IPython.display",
    "matplotlib.pyplot",
    "matplotlib.backends.backend_svg",
    "mlflow.models.display_utils",
    "mlflow.pyfunc.scoring_server",
    "mlflow.pyfunc.utils.environment",
    "mlflow.store.model_registry.sqlalchemy_workspace_store",
    "mlflow.store.tracking.sqlalchemy_workspace_store",
    "mlflow.tracing.export.utils",
    "mlflow.tracing.processor.base_mlflow",
    "mlflow.tracing.processor.otel",
    "mlflow.tracing.utils.environment",
    "mlflow.utils.search_logged_model_utils",
    "optuna.storages._rdb.models",
    "pandas.core.methods.to_dict",
    "pandas.core.reshape.reshape",
    "PIL.BmpImagePlugin",
    "PIL.GifImagePlugin",
    "PIL.JpegImagePlugin",
    "PIL.PpmImagePlugin",
    "pyarrow.acero",
    "pyarrow.dataset",
    "pipeline.dataset.card",
    "pipeline.dataset.physics",
    "pipeline.export",
    "pipeline.networks.feedforward",
    "pipeline.networks.lstm",
    "pipeline.show",
    "scipy.optimize",
    "sqlalchemy.dialects.sqlite",
    "tabulate",
    "torch._dynamo",
    "torch.profiler._cupti_monitor",
)
FIRST = (
    ("scenario", "new", "swarm.json", "--from", "craft=3,size=150", "--to", "craft=3,size=100"),
    ("plan", "swarm.json", "--planner", "refiner", "--out", "plan.json"),
    ("plan", "swarm.json", "--world", "--out", "flown.json"),
    ("fly", "plan.json"),
    ("show", "plan.json"),
    ("sample", "--n", "3", "--count", "24", "--shares", "0.5,0.5,0", "--out", "data"),
    ("solve", "data", "--jobs", "1"),
    ("train", "--arch", "ff1", "--data", "data", "--n", "3", "--epochs", "1"),
)
"""Commands that load what was compiled, and what libraries make at their first use in a process.

These take more of their time than what they do.
"""

HUGE, COLLAPSE = 14, 25  # Linux's MADV_HUGEPAGE and MADV_COLLAPSE

PACKET = 1 << 17  # bytes, above what an environment takes


def main(path: str) -> None:
    """Serve requests until stdin is closed, then stop all processes and remove the socket."""
    gc.disable()  # imports make little garbage, and it is looked for among all that they make
    import_everything()
    gc.freeze()
    do_first()
    spare_children()
    gc.enable()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(path)
        listener.listen()
        if os.fork() == 0:
            serve(listener)
            shutil.rmtree(Path(path).parent, ignore_errors=True)
            os.killpg(0, signal.SIGKILL)
    os._exit(0)


def serve(listener: socket.socket) -> None:
    """Answer requests."""
    ended, wakes = socket.socketpair()
    wakes.setblocking(False)
    signal.set_wakeup_fd(wakes.fileno())
    signal.signal(signal.SIGCHLD, lambda *_: None)
    running: dict[int, socket.socket] = {}
    while sys.stdin not in (ready := select.select([listener, ended, sys.stdin], [], [])[0]):
        if ended in ready:
            ended.recv(PACKET)
            tell_ends(running)
        if listener in ready:
            connection, _ = listener.accept()
            child = start(connection, [listener, ended, wakes, *running.values()])
            running[child] = connection
            say(connection, child)


def import_everything() -> None:
    """Import what commands import, and what libraries import at their first use."""
    import cli.jobs

    for module in pkgutil.iter_modules(cli.jobs.__path__, "cli.jobs."):
        importlib.import_module(module.name)
    for name in LATE:
        with suppress(
            ModuleNotFoundError
        ):  # some are there with the documentation's packages alone
            importlib.import_module(name)


@cache
def command() -> Any:
    """``prolearn``, all of whose commands and options Typer looks at anew in a new process."""
    return sys.modules["typer.main"].get_command(sys.modules["cli.main"].app)


def do_first() -> None:
    """Do what is slow the first time in a process, and the same in all."""
    import mlflow
    import sqlalchemy.orm
    from mlflow.store.db import utils
    from mlflow.utils import requirements_utils
    from typer.testing import CliRunner

    from registry.environment import EVALUATED_BY, TRAINED_BY, environment_tags

    for parts in (TRAINED_BY, EVALUATED_BY):
        environment_tags(parts)  # a digest of their code
    command()
    utils._get_latest_schema_revision = cache(utils._get_latest_schema_revision)
    utils._get_latest_schema_revision()  # reads all of MLflow's migrations
    sqlalchemy.orm.configure_mappers()  # looks at all tables and how they belong together
    requirements_utils._init_packages_to_modules_map()  # looks into every installed package
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        os.environ.pop("MLFLOW_TRACKING_URI", None)  # so that their store is in the folder
        for arguments in FIRST:
            done = CliRunner().invoke(sys.modules["cli.main"].app, arguments)
            assert done.exit_code == 0, done.output
    mlflow.set_tracking_uri(None)


def spare_children() -> None:
    """Spare each child what no test asks for.

    That is to collect garbage in what was imported, torch's work at exit, and many pixels.
    """
    sys.modules["pipeline.figures.style"].RC["savefig.dpi"] = 40
    gc.collect()
    gc.freeze()
    atexit.unregister(sys.modules["torch._dynamo.utils"].dump_compile_times)
    for ending in list(weakref.finalize._registry):  # type: ignore[attr-defined]
        if ending.peek()[1] is sys.modules["torch.library"]._del_library:
            ending.atexit = False
    join_pages()


def join_pages() -> None:
    """Ask Linux for pages of 2 MB in place of 4 kB, whose tables every fork copies."""
    advise = ctypes.CDLL(None).madvise
    for line in Path("/proc/self/maps").read_text().splitlines():
        addresses, rights, _, _, file, *name = line.split()
        first, end = (int(one, 16) for one in addresses.split("-"))
        if file == "0" and rights.startswith("rw") and name in ([], ["[heap]"]):
            for wish in (HUGE, COLLAPSE):  # where it is refused nothing is lost
                advise(ctypes.c_void_p(first), ctypes.c_size_t(end - first), wish)


def start(connection: socket.socket, ours: list[socket.socket]) -> int:
    """Begin what is asked in a process of its own, which has none of our sockets; its id."""
    packet, streams, _, _ = socket.recv_fds(connection, PACKET, 3)
    child = os.fork()
    if child == 0:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        for one in (connection, *ours):
            one.close()
        leave(run(json.loads(packet), streams))
    for stream in streams:
        os.close(stream)
    return child


def tell_ends(running: dict[int, socket.socket]) -> None:
    """Say the status of each process that has ended to whoever asked for it, where they are."""
    while running and (found := os.waitpid(-1, os.WNOHANG))[0]:
        with running.pop(found[0]) as connection:
            say(connection, os.waitstatus_to_exitcode(found[1]))


def say(connection: socket.socket, number: int) -> None:
    """Answer, to nobody where whoever asked has ended."""
    with suppress(OSError):
        connection.send(str(number).encode())


def run(asked: dict[str, Any], streams: list[int]) -> int:
    """The exit status of a command or of a piece of code, in this process."""
    os.environ.clear()
    os.environ.update(asked["environment"])
    os.chdir(asked["folder"])
    tempfile.tempdir = None
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    encoding = os.environ.get("PYTHONIOENCODING")
    sys.stdout = open(1, "w", encoding=encoding, closefd=False)  # noqa: SIM115 - as a new process
    sys.argv[:] = ["prolearn", *asked["arguments"]]
    try:
        if asked["code"]:
            exec(asked["code"], {"__name__": "__main__"})
        else:
            command()()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
        return 1
    return 0


def leave(status: int) -> None:
    """All that an interpreter does at its end, except taking each module apart."""
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


if __name__ == "__main__":
    main(sys.argv[1])
