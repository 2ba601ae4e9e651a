"""Work on a folder of shards, which workers that share its storage read and write themselves."""

import socket
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache, partial
from uuid import uuid4

from pipeline import storage
from pipeline.errors import InputError, ProlearnError
from pipeline.parallel.workers import Content, Result, Task, Workers
from pipeline.storage.folder import Folder, open_folder
from pipeline.text import public_url

_open = lru_cache(maxsize=8)(open_folder)  # a store is connected to once, not for each file


@dataclass(frozen=True)
class Shared:
    """A folder for workers to open, with a mark by which they know that it is the same one."""

    url: str = field(repr=False)  # path or URL, secrets included
    mark: str  # name of a file that exists as long as the work is wanted

    def opened(self) -> Folder:
        """In a worker: the folder; InputError where it does not have the mark."""
        reason = "what is there is another folder, or none"
        try:
            folder = _open(self.url)
            if folder.exists(self.mark):
                return folder
        except ProlearnError as error:
            reason = str(error).rstrip(".")
        raise InputError(
            f"a worker on {socket.gethostname()} does not reach {public_url(self.url)} ({reason}); "
            "expected storage that all machines share: let workers reach it, or leave out --shared."
        )


@contextmanager
def shared(folder: Folder) -> Iterator[Shared]:
    """A folder for workers to open, which has a mark in the block; without it they refuse.

    The mark has the name of an unfinished file, so that readers pass over it, and the next writer
    removes that of a killed one. InputError where another command has done that in the block.
    """
    mark = f".{storage.WRITER}.{uuid4().hex}.tmp"
    folder.publish(mark, b"")
    try:
        yield Shared(folder.address, mark)
    except InputError as error:
        if folder.exists(mark):
            raise
        raise InputError(
            f"{folder} has been taken over by another command, as its storage has no locks between "
            "machines; wait until that one ends, then give this one again."
        ) from error
    finally:
        with suppress(ProlearnError):
            folder.remove(mark)


def work_on(
    folder: Folder,
    workers: Workers,
    function: Callable[[Task, Content], Result],
    tasks: Sequence[Task],
    read: Callable[[Folder, Task], Content],
    write: Callable[[Folder, Result], Result] | None = None,
) -> Generator[tuple[Task, Result], None, None]:
    """Results as of ``Workers.work``, where ``read`` loads the content of each task from a folder.

    Workers that share the folder read there themselves, and ``write`` the result if that is given.
    """
    with ExitStack() as stack:
        if workers.shared:
            in_worker = partial(
                _read_work_write, stack.enter_context(shared(folder)), read, function, write
            )
            results = workers.work(in_worker, tasks, lambda _: None)
        else:
            results = workers.work(function, tasks, partial(read, folder))
        yield from stack.enter_context(closing(results))


def _read_work_write(
    where: Shared,
    read: Callable[[Folder, Task], Content],
    function: Callable[[Task, Content], Result],
    write: Callable[[Folder, Result], Result] | None,
    task: Task,
    _: None,
) -> Result:
    result = function(task, read(where.opened(), task))
    # Opened again: once its mark is gone, as after the client's end, a folder is not written to.
    return result if write is None else write(where.opened(), result)
