"""How commands run: errors and signals as a sentence and an exit status, memory within limits."""

import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from errno import ENOSPC, EPIPE
from pathlib import Path
from types import FrameType
from typing import Any

import typer
from typer.core import TyperGroup

from cli.output import echo, escape_unencodable
from pipeline.errors import InputError, ProlearnError, missing_extra_hint
from pipeline.files import refuse_dataset, refuse_special, unfinished
from pipeline.text import public, visible

FAILED, BAD_INPUT, INTERRUPTED, TERMINATED = 1, 2, 130, 143


class Terminated(KeyboardInterrupt):
    """The interrupt that SIGTERM raises, so that it ends a run as Ctrl-C does."""


RETRY_SECONDS = 0.05  # delay after which an interrupt that a callback has swallowed is raised again
EXIT_SECONDS = 5.0  # longest that Python waits for threads at the end of an interrupted command
# Key in a command's context of the typed words and values of options
TYPED = "prolearn.typed"
# Typer's error for arguments that a command does not have; its message quotes them
USAGE: Any = typer.BadParameter.__base__
CONTROL_GROUP = Path("/sys/fs/cgroup")  # files with a container's limit of memory and its use


class CommandGroup(TyperGroup):
    """A group of commands whose errors are one sentence and an exit status."""

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A command of the group; lists have the first line of its help, which Click would cut."""
        found = super().get_command(ctx, cmd_name)
        if found is not None and found.help:
            found.short_help = found.help.partition("\n")[0]
        return found

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse what was typed and keep it: it may hold URLs, whose secrets no message shows."""
        escape_unencodable()
        if os.environ.get("COLUMNS") == "0":  # as where a width is not known: rich prints nothing
            del os.environ["COLUMNS"]
        ctx.meta[TYPED] = [re.sub("^--[a-z-]+=", "", word) for word in args]
        try:
            return super().parse_args(ctx, args)
        except OSError as error:  # of --help and --version, which are printed here
            _fail(ctx, error)
            raise

    def invoke(self, ctx: Any) -> Any:
        """Run a command: bad input exits with 2, a failed run with 1, neither with a traceback."""
        try:
            with _sigterm_raises(), missing_extra_hint():
                return super().invoke(ctx)
        except USAGE as error:
            error.message = visible(public(error.message, *ctx.meta.get(TYPED, ())))
            raise
        except (ProlearnError, OSError) as error:
            _fail(ctx, error)
            raise
        except MemoryError:
            words = "this takes more memory than the system gives; expected more of it"
            _stop(ctx, f"{words}, or less to do.", FAILED)
        except KeyboardInterrupt as stop:
            ended = isinstance(stop, Terminated)
            word, status = ("terminated", TERMINATED) if ended else ("interrupted", INTERRUPTED)
            _end_in_time(status)
            # Commands that do not say what is kept continue from there when they are run again.
            _stop(ctx, f"{word}; {str(stop) or 'what was finished is kept.'}", status)


@contextmanager
def _sigterm_raises() -> Iterator[None]:
    """In the block a first SIGTERM raises Terminated; a second ends the process at once.

    It and Ctrl-C end the run even where they arrive in a weak reference's callback or a finalizer,
    whose exceptions Python only reports.
    """
    if threading.current_thread() is not threading.main_thread():  # it cannot set handlers
        yield
        return

    def end(number: int, _: FrameType | None) -> None:
        signal.signal(number, signal.SIG_DFL)
        raise Terminated

    def hook(unraisable: Any) -> None:
        def again(*_: Any) -> None:
            raise unraisable.exc_type

        if isinstance(unraisable.exc_value, KeyboardInterrupt):
            signal.signal(signal.SIGALRM, again)
            signal.setitimer(signal.ITIMER_REAL, RETRY_SECONDS)
        else:
            usual(unraisable)

    before, usual = signal.signal(signal.SIGTERM, end), sys.unraisablehook
    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = usual
        signal.signal(signal.SIGTERM, before)


def _end_in_time(status: int) -> None:
    """Exit with a status EXIT_SECONDS after the main thread, even if other threads still run.

    Python waits for threads that are not daemons. One of a library's pool never ends where the
    interrupt came after its start and before the pool had noted it.
    """

    def end() -> None:
        threading.main_thread().join()
        time.sleep(EXIT_SECONDS)
        os._exit(status)

    threading.Thread(target=end, daemon=True).start()


def _message_of(error: Exception) -> str:
    """An error's message, which names the file that the user knows and not our temporary one."""
    if not (isinstance(error, OSError) and error.strerror):
        return str(error)
    # A full disk is reported without a file for stdout alone; other errors without one are whole.
    full = error.filename is None and error.strerror == os.strerror(ENOSPC)
    name = "stdout" if full else error.filename
    if not isinstance(name, str):
        return str(error)
    path = Path(name)
    return (
        f"{unfinished(path) or path} cannot be read or written ({error.strerror}); expected one "
        "that can: name another, or check its permissions and the space on its disk."
    )


def _fail(ctx: Any, error: Exception) -> None:
    """End the command with a sentence, unless stdout's reader is gone: click is silent then."""
    if getattr(error, "errno", None) != EPIPE:
        _stop(ctx, _message_of(error), BAD_INPUT if isinstance(error, InputError) else FAILED)


def _stop(ctx: Any, message: str, status: int) -> None:
    # Every message is printed here, and no secret that was typed is in it.
    echo(f"prolearn: {public(message, *ctx.meta.get(TYPED, ()))}", err=True)
    _drop_unwritable()
    raise typer.Exit(status)


def _drop_unwritable() -> None:
    """Discard buffered output that stdout cannot take; else Python fails once more at its exit."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def explained_interrupt(kept: Callable[[], str]) -> Iterator[None]:
    """In the block Ctrl-C and SIGTERM end the run with a sentence on what is kept."""
    try:
        yield
    except KeyboardInterrupt as stop:
        stop.args = (kept(),)
        raise


def refuse_overwriting(source: Path, target: Path) -> None:
    """Raise InputError for an output over its own input or a pipe, or in a dataset's folder."""
    refuse_special(target)
    refuse_dataset(target)
    if source.exists() and target.exists() and target.samefile(source):
        raise InputError(
            f"{target} is the input and would be overwritten; expected another name for the "
            "output: give --out."
        )


@contextmanager
def within_memory() -> Iterator[None]:
    """In the block this process gets no more memory than is free, where the system is Linux.

    Linux grants memory that it does not have, and kills a process that uses it. With a limit the
    request fails, and a ProlearnError takes the place of the MemoryError.
    """
    free = available()
    try:
        with nullcontext() if free is None or sys.platform != "linux" else _limited(free):
            yield
    except MemoryError as error:
        room = "" if free is None else f" than the {free / 1e9:.3g} GB that are free"
        raise ProlearnError(
            f"this takes more memory{room}; expected fewer craft or nodes, or shorter intervals."
        ) from error


@contextmanager
def _limited(free: int) -> Iterator[None]:
    """In the block private memory grows by at most so many bytes."""
    import resource

    soft, hard = before = resource.getrlimit(resource.RLIMIT_DATA)
    wanted = 1024 * _listed(Path("/proc/self/status"), "VmData:") + free
    limits = [one for one in (wanted, soft, hard) if one != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_DATA, (min(limits), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def available() -> int | None:
    """Memory in bytes that is free for this process, or None where the system does not say."""
    try:
        system = 1024 * _listed(Path("/proc/meminfo"), "MemAvailable:")
    except (OSError, ValueError):
        return None
    try:
        most = int((CONTROL_GROUP / "memory.max").read_text())
        used = int((CONTROL_GROUP / "memory.current").read_text())
        # Of files, given back when memory is asked for
        cached = _listed(CONTROL_GROUP / "memory.stat", "inactive_file ")
    except (OSError, ValueError):  # no container, or one without a limit
        return system
    return min(system, max(most - used + cached, 0))


def _listed(path: Path, name: str) -> int:
    """Integer after a name in a file of the kernel, as in /proc; ValueError where it is missing."""
    for line in path.read_text().splitlines():
        if line.startswith(name):
            return int(line.split()[1])
    raise ValueError(f"{path} has no {name}")
