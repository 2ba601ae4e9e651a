"""A folder of shards under way: shards are published, and the manifest commits to them."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from time import monotonic
from typing import Any, ClassVar, Generic, Protocol, TypeVar, runtime_checkable

from pipeline.errors import ProlearnError
from pipeline.storage.folder import Folder
from pipeline.storage.layout import STAMPS
from pipeline.storage.lock import sole_writer
from pipeline.storage.shards import digest_of

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


Kind = TypeVar("Kind", bound=Manifest)


class Ledger(Generic[Kind]):
    """The manifest that a stage brings up to date, and the folder that it describes.

    Attributes:
        folder: where the shards are.
        manifest: what is known of them by now.
    """

    def __init__(
        self, folder: Folder, manifest: Kind, write: Callable[[Folder, Kind], None]
    ) -> None:
        self.folder, self.manifest, self._write = folder, manifest, write
        self._stamps = _read_stamps(folder)
        self._committed: tuple[Kind | None, Stamps] = None, dict(self._stamps)
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

    def publish(self, name: str, content: bytes) -> None:
        """Put a shard into the folder and commit to it, at once or a little later."""
        self.folder.publish(name, content)
        self.adopt(name, content)
        stamp = self.folder.stamp(name)
        if stamp is not None:
            self._stamps[name] = [*stamp, self.manifest.shards[name]]
        if monotonic() >= self._not_before:
            self.commit()

    def adopt(self, name: str, content: bytes) -> None:
        """Count a shard that is in the folder already."""
        shards = {**self.manifest.shards, name: digest_of(content)}
        self.manifest = replace(self.manifest, shards=shards)

    def disown(self, names: Iterable[str]) -> None:
        """Count shards no longer."""
        left = {k: v for k, v in self.manifest.shards.items() if k not in set(names)}
        self.manifest = replace(self.manifest, shards=left)

    def commit(self) -> None:
        """Write the manifest and the stamps, where they have changed."""
        started = monotonic()
        manifest, stamps = self._committed
        if self.manifest != manifest:
            self._write(self.folder, self.manifest)
        if self._stamps != stamps:
            self.folder.publish(STAMPS, (json.dumps(self._stamps, indent=1) + "\n").encode())
        self._committed = self.manifest, dict(self._stamps)
        now = monotonic()
        self._not_before = now + (now - started) / COMMIT_SHARE


@contextmanager
def written(
    folder: Folder, begun: Callable[[], Kind], write: Callable[[Folder, Kind], None]
) -> Iterator[Ledger[Kind]]:
    """The ledger of a folder that is held for writing, committed unless the process is killed.

    Args:
        folder: of shards, or where it shall be.
        begun: its manifest, or the refusal to go on with it; asked once the folder is held.
        write: writes the manifest.
    """
    with sole_writer(folder):
        ledger = Ledger(folder, begun(), write)
        ledger.commit()
        try:
            yield ledger
        except BaseException:
            with suppress(ProlearnError):
                ledger.commit()
            raise
        ledger.commit()


def _read_stamps(folder: Folder) -> Stamps:
    """None where they are missing or damaged: then the shards are read."""
    try:
        found = json.loads(folder.read(STAMPS))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
