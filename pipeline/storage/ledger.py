"""Writing of a folder of shards, by one process at a time, and of the manifest that lists them."""

import json
import os
import re
import socket
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from itertools import count
from pathlib import Path
from reprlib import repr as brief
from time import monotonic
from typing import Any, Protocol, TypeVar, runtime_checkable

import pyarrow as pa
from filelock import FileLock, Timeout

from pipeline import storage
from pipeline.documents import parse_json, with_checksum, without_checksum
from pipeline.errors import InputError, ProlearnError, error_context
from pipeline.files import make_folder, unfinished
from pipeline.parallel.workers import Workers
from pipeline.progress import Progress
from pipeline.storage import shards
from pipeline.storage.folder import Folder, Stamp
from pipeline.storage.shared import work_on

TIMED_SCHEMA = "prolearn.timings/1"
COMMIT_SHARE = 0.1  # largest share of the time that may go into commits of the manifest


def write_checked(folder: Folder, name: str, fields: Mapping[str, Any], copy: str = "") -> None:
    """Publish a JSON document with its checksum, and then a copy if a name is given for it."""
    content = (json.dumps(with_checksum(fields), indent=1) + "\n").encode()
    for path in filter(None, (name, copy)):
        folder.publish(path, content)


def read_checked(folder: Folder, name: str) -> dict[str, Any]:
    """The fields of a JSON document; OSError or ValueError where it is unreadable or damaged."""
    fields = parse_json(folder.read(name))
    if not isinstance(fields, dict):
        raise ValueError("it is no JSON object")
    return without_checksum(fields)


def listed_shards(folder: Folder, schema: str) -> dict[str, str]:
    """SHA-256 of each shard in a folder's manifest, or in its copy; empty without either.

    InputError where that has another schema, since a ledger would overwrite it.
    """
    for name in (storage.MANIFEST, storage.COPY):
        with suppress(OSError, ValueError, KeyError, TypeError):
            found = read_checked(folder, name)
            if found["schema"] != schema:
                raise InputError(
                    f"{name} in {folder} has the schema {brief(found['schema'])}; expected "
                    f"{schema!r}, or no file of that name: give another folder."
                )
            return dict(found["shards"])
    return {}


class Ledger:
    """The manifest of a folder that is being written, kept up to date with its shards."""

    def __init__(self, folder: Folder, fields: Mapping[str, Any], progress: Progress) -> None:
        """Begin with the fields of a manifest, among them ``shards``."""
        self.folder, self._fields, self._progress = folder, fields, progress
        # SHA-256 of each shard, by its path: grows in place, since a folder may have very many.
        self.shards = dict(fields["shards"])
        known = read_timing_digests(folder) if folder.exists(storage.TIMED) else {}
        # SHA-256 of each shard of timings, by the path of the shard that they belong to.
        self.timing_digests = dict(known or {})
        # By shard: size, time of the last change and digest when it was last known to be sound.
        self._stamps = _read_stamps(folder)
        self._committed: tuple[Any, ...] = None, known, dict(self._stamps)
        self._next_commit = -float("inf")

    def is_sound(self, name: str) -> bool:
        """Whether a shard has the digest in the manifest; read only where it may have changed."""
        known = self.shards.get(name)
        if known is None:
            return False
        stamp = self.folder.stamp(name)
        if stamp is not None and self._stamps.get(name) == [*stamp, known]:
            return True
        sound = _has_digest(self.folder, name, known)
        if sound and stamp is not None:
            self._stamps[name] = [*stamp, known]
        return sound

    def publish(self, shard: "NewShard") -> None:
        """Write a shard, unless a worker has, and its timings; drop its derived one if it changed.

        Timings differ each time that a shard is made, so no worker writes them: one that was taken
        for lost would replace those that the ledger knows. Shards are the same whoever writes them.
        """
        name, content = shard.name, shard.content
        if shard.timings is not None:
            self.folder.publish(storage.TIMINGS + name, shard.timings)
            self.timing_digests[name] = shards.digest_of(shard.timings)
        if isinstance(content, bytes):
            content = write(self.folder, name, content, self.shards.get(name, ""))
        for notice in content.notices:
            self._progress.say(notice)
        if self.shards.get(name, content.digest) != content.digest:
            self.drop([shard.derived])
        self.shards[name] = content.digest
        if content.stamp is not None:
            self._stamps[name] = [*content.stamp, content.digest]
        if monotonic() >= self._next_commit:
            self.commit()

    def adopt(self, name: str, most: shards.Size, fits: Callable[[pa.Table], bool]) -> bool:
        """Add a shard that a killed run did not commit, if it is intact and ``fits`` its place."""
        try:
            content, timings = self.folder.read(name), self.folder.read(storage.TIMINGS + name)
            table = shards.decode(content, most)
            belongs_to = (shards.decode(timings, most).schema.metadata or {}).get(shards.TIMED_KEY)
            # Encoded again, since not every byte has a checksum.
            intact = fits(table) and shards.encode(table) == content
        except (OSError, InputError):
            return False
        digest = shards.digest_of(content)
        if not intact or belongs_to != digest.encode():
            return False
        self.shards[name] = digest
        self.timing_digests[name] = shards.digest_of(timings)
        return True

    def drop(self, names: Iterable[str]) -> None:
        """Drop shards from the manifest."""
        for name in names:
            self.shards.pop(name, None)

    def commit(self) -> None:
        """Write the manifest, the digests of timings and the stamps, where they have changed."""
        started = monotonic()
        now = dict(self.shards), dict(self.timing_digests), dict(self._stamps)
        listed, digests, stamps = self._committed
        if self.timing_digests != digests:
            fields = {"schema": TIMED_SCHEMA, "shards": dict(sorted(now[1].items()))}
            write_checked(self.folder, storage.TIMED, fields)
        if self.shards != listed:
            fields = {**self._fields, "shards": dict(sorted(now[0].items()))}
            write_checked(self.folder, storage.MANIFEST, fields, storage.COPY)
        if self._stamps != stamps:
            text = json.dumps(self._stamps, indent=1) + "\n"
            self.folder.publish(storage.STAMPS, text.encode())
        self._committed, ended = now, monotonic()
        self._next_commit = ended + (ended - started) / COMMIT_SHARE


@dataclass(frozen=True)
class WrittenShard:
    """What a ledger needs to know of a shard that has been written."""

    digest: str
    stamp: Stamp | None
    notices: Sequence[str] = ()  # sentences for the user


def write(folder: Folder, name: str, content: bytes, known: str = "") -> WrittenShard:
    """Write a shard, unless it is there; another file of its name is set aside as damaged.

    A file of the digest ``known`` is intact and, as of fewer rows, overwritten.
    """
    digest, exists = shards.digest_of(content), folder.exists(name)
    notices = []
    if not (exists and _has_digest(folder, name, digest)):
        if exists and not (known and _has_digest(folder, name, known)):
            notices.append(set_aside(folder, name))
        folder.publish(name, content)
    return WrittenShard(digest, folder.stamp(name), notices)


def _has_digest(folder: Folder, name: str, digest: str) -> bool:
    try:
        return shards.digest_of(folder.read(name)) == digest
    except OSError:
        return False


@dataclass(frozen=True)
class NewShard:
    """A shard that a worker has made."""

    name: str
    content: bytes | WrittenShard
    timings: bytes | None = None
    derived: str = ""  # name of the shard that is made from this one
    failed: int | None = None  # number of rows without a result


@runtime_checkable
class RowsTask(Protocol):
    """A task for a worker: some rows of a table."""

    @property
    def rows(self) -> range:
        """Their numbers."""


Task = TypeVar("Task", bound=RowsTask)


def write_shards(
    ledger: Ledger,
    make: Callable[[Task, bytes], NewShard],
    tasks: Sequence[Task],
    workers: Workers,
    source: Callable[[Task], str] = lambda _: "",
) -> None:
    """Make shards on workers and publish each as soon as it is done.

    ``make`` gets a task and the content of its source, the shard, if any, that ``source`` names.
    """
    workers.progress.expect(sum(len(task.rows) for task in tasks))
    sources = zip(tasks, map(source, tasks), strict=True)
    with_source = [(task, name, ledger.shards.get(name, "")) for task, name in sources]
    function = partial(_make, make)
    made = work_on(ledger.folder, workers, function, with_source, _read, _written)
    with closing(made) as results:
        for (task, *_), shard in results:
            ledger.publish(shard)
            workers.progress.done(len(task.rows), failed=shard.failed)


Sourced = tuple[Task, str, str]
"""A task with the path and digest of its source, both empty without one."""


def _make(
    make: Callable[[Task, bytes], NewShard], sourced: Sourced[Task], content: bytes
) -> NewShard:
    return make(sourced[0], content)


def _read(folder: Folder, sourced: Sourced[Task]) -> bytes:
    _, name, digest = sourced
    with error_context(f"{name} in {folder}"):
        return shards.read_verified(folder, name, digest) if name else b""


def _written(folder: Folder, shard: NewShard) -> NewShard:
    """In a worker that shares the folder: write the shard, whose bytes need not travel then."""
    if isinstance(shard.content, bytes):
        return replace(shard, content=write(folder, shard.name, shard.content))
    return shard


def set_aside(folder: Folder, name: str, below: str = storage.DAMAGED) -> str:
    """Move a file under a new name to where readers pass over it; a sentence that says so."""
    names = (f"{below}{name}.{number}" for number in count(1))
    new_name = next(free for free in names if not folder.exists(free))
    folder.move(name, new_name)
    return f"{name} in {folder} is set aside as {new_name}."


@contextmanager
def sole_writer(folder: Folder, owned: str) -> Iterator[None]:
    """Lock a folder for writing, and remove the unfinished files of killed writers.

    The lock is the operating system's, so it ends with its process, however that ends. Object
    stores have none: two runs there both finish, with identical bytes.

    ``owned`` is the pattern of the files that writers of such folders make; unfinished files of
    other names are somebody else's, and stay. InputError where another process has the lock.
    """
    if folder.local is None:
        yield
        return
    top, ours = folder.local, re.compile(f"{storage.WRITTEN}|{owned}")
    with _locked(folder, top):
        for path in [path for place in storage.PLACES for path in top.glob(f"{place}.*.tmp")]:
            final = unfinished(path)
            if final and ours.fullmatch(final.relative_to(top).as_posix()) and path.is_file():
                with suppress(ProlearnError):  # a worker of a killed client may just finish it
                    folder.remove(path.relative_to(top).as_posix())
        now = datetime.now().astimezone().isoformat(timespec="seconds")
        writer = f"process {os.getpid()} on {socket.gethostname()}, since {now}"
        try:
            folder.publish(storage.WRITER, writer.encode())
            yield
        finally:
            with suppress(ProlearnError):
                folder.remove(storage.WRITER)


def _locked(folder: Folder, path: Path) -> AbstractContextManager[object]:
    try:
        make_folder(path)
        return FileLock(path / storage.LOCK, timeout=0).acquire()
    except Timeout as error:
        holder = "another process"
        with suppress(OSError):
            holder = folder.read(storage.WRITER).decode()
        raise InputError(
            f"{folder} is being written by {holder}; wait for it, or work in another folder."
        ) from error
    except (OSError, NotImplementedError) as error:
        raise ProlearnError(
            f"{folder} cannot be written to ({folder.reason(error)}); give a folder that can."
        ) from error


@contextmanager
def open_ledger(folder: Folder, fields: Mapping[str, Any], progress: Progress) -> Iterator[Ledger]:
    """The ledger of a folder that this process holds by ``sole_writer``.

    It begins with the fields of a manifest, and is committed before and after the block, unless the
    process is killed.
    """
    ledger = Ledger(folder, fields, progress)
    ledger.commit()
    try:
        yield ledger
    except BaseException:
        with suppress(ProlearnError):
            ledger.commit()
        raise
    ledger.commit()


def read_timing_digests(folder: Folder) -> dict[str, str] | None:
    """Digests of timings by the path of their shard, or None where they cannot be read."""
    try:
        fields = read_checked(folder, storage.TIMED)
        return dict(fields["shards"]) if fields["schema"] == TIMED_SCHEMA else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _read_stamps(folder: Folder) -> dict[str, list[int | str]]:
    """The stamps of shards; none if missing or damaged, and each shard is then read."""
    try:
        found = parse_json(folder.read(storage.STAMPS))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
