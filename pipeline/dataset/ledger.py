"""A dataset under way: shards are published, and the manifest commits to them."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from time import monotonic

from pipeline.dataset.folder import Folder
from pipeline.dataset.manifest import Manifest, write_manifest
from pipeline.dataset.shards import digest_of
from pipeline.errors import ProlearnError

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

    def is_sound(self, name: str) -> bool:
        """Whether a shard is there and has the digest that the manifest gives it."""
        known = self.manifest.shards.get(name)
        return known is not None and self.digest(name) == known

    def digest(self, name: str) -> str | None:
        """Digest of a file as it is now, or None where there is none that can be read."""
        try:
            return digest_of(self.folder.read(name))
        except OSError:
            return None

    def publish(self, name: str, content: bytes) -> None:
        """Put a shard into the folder and commit to it, at once or a little later."""
        self.folder.publish(name, content)
        self.adopt(name, digest_of(content))
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
        """Write the manifest, where it has changed."""
        if self.manifest == self._committed:
            return
        started = self._clock()
        write_manifest(self.folder, self.manifest)
        self._committed = self.manifest
        now = self._clock()
        self._not_before = now + (now - started) / COMMIT_SHARE
