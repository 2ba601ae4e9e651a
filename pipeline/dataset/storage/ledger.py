"""A dataset under way: shards are published, and the manifest commits to them."""

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from time import monotonic

from pipeline.dataset.storage.folder import Folder, Stamp
from pipeline.dataset.storage.manifest import Manifest, write_manifest
from pipeline.dataset.storage.shards import digest_of
from pipeline.errors import ProlearnError

STAMPS = "_stamps.json"
"""By shard, its size, last change and digest when it was last known to be sound."""

COMMIT_SHARE = 0.1
"""Most of the time that may go into commits; small manifests are committed after each shard."""


class Ledger:
    """The manifest that a stage brings up to date, and the folder that it describes."""

    def __init__(
        self, folder: Folder, manifest: Manifest, clock: Callable[[], float] = monotonic
    ) -> None:
        self.folder, self.manifest = folder, manifest
        self._clock = clock
        self._not_before = -float("inf")
        self._committed: Manifest | None = None
        self._stamps = self._read_stamps()
        self._written = dict(self._stamps)

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
        if self.digest(name) != known:
            return False
        self._stamp(name, stamp, known)
        return True

    def _stamp(self, name: str, stamp: Stamp | None, digest: str) -> None:
        if stamp is not None:
            self._stamps[name] = [*stamp, digest]

    def _read_stamps(self) -> dict[str, list[int | str]]:
        """None where they are missing or damaged: then the shards are read."""
        try:
            found = json.loads(self.folder.read(STAMPS))
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    def digest(self, name: str) -> str | None:
        """Digest of a file as it is now, or None where there is none that can be read."""
        try:
            return digest_of(self.folder.read(name))
        except OSError:
            return None

    def publish(self, name: str, content: bytes) -> None:
        """Put a shard into the folder and commit to it, at once or a little later."""
        self.folder.publish(name, content)
        digest = digest_of(content)
        self.adopt(name, digest)
        self._stamp(name, self.folder.stamp(name), digest)
        if self._clock() >= self._not_before:
            self.commit()

    def adopt(self, name: str, digest: str) -> None:
        """Count a shard that is in the folder already."""
        shards = {**self.manifest.shards, name: digest}
        self.manifest = replace(self.manifest, shards=shards)

    def disown(self, names: Iterable[str]) -> None:
        """Count shards no longer."""
        left = {k: v for k, v in self.manifest.shards.items() if k not in set(names)}
        self.manifest = replace(self.manifest, shards=left)

    @contextmanager
    def settled(self) -> Iterator[None]:
        """Commit in the end, however the work ends short of being killed."""
        try:
            yield
        except BaseException:
            with suppress(ProlearnError):
                self.commit()
            raise
        self.commit()

    def commit(self) -> None:
        """Write the manifest and the stamps, where they have changed."""
        started = self._clock()
        if self.manifest != self._committed:
            write_manifest(self.folder, self.manifest)
            self._committed = self.manifest
        if self._stamps != self._written:
            self.folder.publish(STAMPS, (json.dumps(self._stamps, indent=1) + "\n").encode())
            self._written = dict(self._stamps)
        now = self._clock()
        self._not_before = now + (now - started) / COMMIT_SHARE
