"""A folder of shards under way: shards are published, and the manifest commits to them."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import count
from time import monotonic
from typing import Any, ClassVar, Generic, Protocol, TypeVar, runtime_checkable

from pipeline.documents import parsed
from pipeline.errors import InputError, ProlearnError
from pipeline.progress import Progress
from pipeline.storage.checked import read_checked, write_checked
from pipeline.storage.folder import Folder
from pipeline.storage.layout import COPY, DAMAGED, MANIFEST, STAMPS, TIMED, TIMINGS
from pipeline.storage.lock import sole_writer
from pipeline.storage.shards import TIMED_KEY, Size, decode, digest_of

TIMED_SCHEMA = "prolearn.timings/1"

COMMIT_SHARE = 0.1
"""Most of the time that may go into commits; small manifests are committed after each shard."""

Stamps = dict[str, list[int | str]]
"""By shard, its size, last change and digest when it was last known to be sound."""


@runtime_checkable
class Manifest(Protocol):
    """A frozen dataclass that names the shards of a folder."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def shards(self) -> Mapping[str, str]:
        """SHA-256 digest of each finished shard, by path inside the folder."""
        ...

    def fields(self) -> dict[str, Any]:
        """What its file has, JSON-ready."""
        ...


Kind = TypeVar("Kind", bound=Manifest)


class Ledger(Generic[Kind]):
    """The manifest that a stage brings up to date, and the folder that it describes.

    Attributes:
        folder: where the shards are.
        manifest: what is known of them by now.
        timed: SHA-256 digest of each shard of timings, by the path of the shard they belong to.
    """

    def __init__(self, folder: Folder, manifest: Kind, progress: Progress) -> None:
        self.folder, self.manifest, self._progress = folder, manifest, progress
        self.timed = read_timed(folder) or {}
        self._stamps = _read_stamps(folder)
        known = read_timed(folder) if folder.exists(TIMED) else {}
        self._committed: tuple[Any, ...] = None, known, dict(self._stamps)
        self._not_before = -float("inf")

    def is_sound(self, name: str) -> bool:
        """Whether a shard is there and has the digest that the manifest gives it.

        It is read only where it may have changed since that was last known.
        """
        known = self.manifest.shards.get(name)
        if known is None:
            return False
        stamp = self.folder.stamp(name)
        if stamp is not None and self._stamps.get(name) == [*stamp, known]:
            return True
        try:
            sound = digest_of(self.folder.read(name)) == known
        except OSError:
            return False
        if sound and stamp is not None:
            self._stamps[name] = [*stamp, known]
        return sound

    def publish(self, name: str, content: bytes, timings: bytes | None = None) -> None:
        """Put a shard and its timings into the folder and commit to them, at once or a bit later.

        Another file in the shard's place is set aside.
        """
        digest = digest_of(content)
        if self.folder.exists(name) and not self._holds(name, digest):
            set_aside(self.folder, name, self._progress)
        if timings is not None:
            self.folder.publish(TIMINGS + name, timings)
            self.timed[name] = digest_of(timings)
        self.folder.publish(name, content)
        self._count(name, digest)
        stamp = self.folder.stamp(name)
        if stamp is not None:
            self._stamps[name] = [*stamp, digest]
        if monotonic() >= self._not_before:
            self.commit()

    def adopt(self, name: str, content: bytes, most: Size) -> bool:
        """Count a shard that is in the folder already, if its timings are there too."""
        digest = digest_of(content)
        try:
            timings = self.folder.read(TIMINGS + name)
            said = (decode(timings, most).schema.metadata or {}).get(TIMED_KEY)
        except (OSError, InputError):
            return False
        if said != digest.encode():
            return False
        self._count(name, digest)
        self.timed[name] = digest_of(timings)
        return True

    def disown(self, names: Iterable[str]) -> None:
        """Count shards no longer."""
        left = {k: v for k, v in self.manifest.shards.items() if k not in set(names)}
        self.manifest = replace(self.manifest, shards=left)

    def commit(self) -> None:
        """Write the manifest, the digests of timings and the stamps, where they have changed."""
        started = monotonic()
        manifest, timed, stamps = self._committed
        if self.timed != timed:
            shards = dict(sorted(self.timed.items()))
            write_checked(self.folder, TIMED, {"schema": TIMED_SCHEMA, "shards": shards})
        if self.manifest != manifest:
            write_checked(self.folder, MANIFEST, self.manifest.fields(), COPY)
        if self._stamps != stamps:
            self.folder.publish(STAMPS, (json.dumps(self._stamps, indent=1) + "\n").encode())
        self._committed = self.manifest, dict(self.timed), dict(self._stamps)
        now = monotonic()
        self._not_before = now + (now - started) / COMMIT_SHARE

    def _count(self, name: str, digest: str) -> None:
        self.manifest = replace(self.manifest, shards={**self.manifest.shards, name: digest})

    def _holds(self, name: str, digest: str) -> bool:
        try:
            return digest_of(self.folder.read(name)) == digest
        except OSError:
            return False


def set_aside(folder: Folder, name: str, progress: Progress, top: str = DAMAGED) -> None:
    """Move a file out of the way of readers, where it takes no other's place, and say so."""
    there = set(folder.names())
    names = (f"{top}{name}.{number}" for number in count(1))
    aside = next(one for one in names if one not in there)
    folder.move(name, aside)
    progress.say(f"{name} in {folder} is set aside as {aside}.")


@contextmanager
def committed(ledger: Ledger[Kind]) -> Iterator[Ledger[Kind]]:
    """A ledger that is committed before and after the block, unless the process is killed."""
    ledger.commit()
    try:
        yield ledger
    except BaseException:
        with suppress(ProlearnError):
            ledger.commit()
        raise
    ledger.commit()


@contextmanager
def written(
    folder: Folder, owned: str, begun: Callable[[], Kind], progress: Progress
) -> Iterator[Ledger[Kind]]:
    """The ledger of a folder that is held for writing.

    Args:
        folder: of shards, or where it shall be.
        owned: pattern of the names of its files, as for ``sole_writer``.
        begun: its manifest, or the refusal to go on with it; asked once the folder is held.
        progress: told of files that are set aside.
    """
    with sole_writer(folder, owned), committed(Ledger(folder, begun(), progress)) as ledger:
        yield ledger


def read_timed(folder: Folder) -> dict[str, str] | None:
    """Digests of timings by the path of their shard, or None where they cannot be read."""
    try:
        fields = read_checked(folder, TIMED)
        return dict(fields["shards"]) if fields["schema"] == TIMED_SCHEMA else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _read_stamps(folder: Folder) -> Stamps:
    """None where they are missing or damaged: then the shards are read."""
    try:
        found = parsed(folder.read(STAMPS))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
