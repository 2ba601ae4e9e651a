"""The manifest of a dataset folder: what it is meant to hold, and the digest of every shard."""

import hashlib
import json
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any

from pydantic import ConfigDict, PlainValidator, TypeAdapter, ValidationError

from pipeline.dataset.format.layout import SCENARIOS
from pipeline.dataset.format.samples import Sample
from pipeline.dataset.format.schema import SCHEMA, metadata
from pipeline.documents import first_fault
from pipeline.errors import InputError
from pipeline.orbit.problem import Problem
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.layout import MANIFEST, TIMINGS
from pipeline.storage.ledger import Ledger, written


@dataclass(frozen=True)
class MadeWith:
    """Versions by name.

    Attributes:
        sample: those that the scenarios were drawn with.
        solve: those that they are solved with, or nothing before the first solve.
    """

    sample: Mapping[str, str]
    solve: Mapping[str, str]


@dataclass(frozen=True)
class Manifest:
    """What a dataset folder is meant to hold and what of it is there; laid out as in the file.

    Attributes:
        problem: the problem that all its instances share.
        samples: how each swarm size is drawn.
        solve: settings of the expert, or nothing before the first solve.
        made_with: versions that it was made with.
        shards: SHA-256 digest of each finished shard, by path inside the folder.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    # As written: an integer stays one, since the metadata of shards repeats it to the letter.
    problem: Annotated[Problem, PlainValidator(lambda fields: Problem(**fields))]
    samples: Mapping[int, Sample]
    solve: Mapping[str, Any]
    made_with: MadeWith
    shards: Mapping[str, str]

    def expected(self) -> "list[Shard]":
        """All that it is meant to hold, in order."""
        about = replace(self, shards={})
        sizes = sorted(self.samples.items())
        return [Shard(about, n, k) for n, one in sizes for k in range(one.shards)]

    def digest(self, n: int | None = None) -> str:
        """Digest of the solved data, or of one swarm size: the same bytes, the same digest."""
        top = "n=" if n is None else f"n={n}/"
        solved = {p: d for p, d in self.shards.items() if p.startswith(top)}
        return hashlib.sha256(json.dumps(solved, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Shard:
    """Some rows of a dataset, with all that decides what they are.

    Attributes:
        about: the manifest without its digests, which a worker has no use for.
        n: swarm size.
        number: which of that size's shards.
    """

    about: Manifest
    n: int
    number: int

    @property
    def sample(self) -> Sample:
        """How its scenarios are drawn."""
        return self.about.samples[self.n]

    @property
    def rows(self) -> range:
        """Its rows, counted over the whole sample."""
        return self.sample.rows(self.number)

    @property
    def solved(self) -> str:
        """Path of its solved instances inside the folder."""
        return f"n={self.n}/part-{self.number:05d}.parquet"

    @property
    def scenarios(self) -> str:
        """Path of the scenarios that they come from."""
        return SCENARIOS + self.solved

    @property
    def timings(self) -> str:
        """Path of how long each took."""
        return TIMINGS + self.solved

    def metadata(self, path: str) -> dict[bytes, bytes]:
        """The schema metadata of its scenarios or of its solved instances."""
        about, origin = self.about, self.sample.origin()
        if path == self.scenarios:
            return metadata(about.problem, origin, about.made_with.sample)
        return metadata(about.problem, origin | dict(about.solve), about.made_with.solve)


def read_manifest(where: Where | Folder) -> Manifest:
    """The manifest of a dataset.

    Raises:
        InputError: where the folder is missing, empty or holds no dataset.
    """
    folder = open_folder(where)
    if not folder.exists(MANIFEST):
        what = "does not exist"
        if folder.is_there():
            what = "holds no dataset" if folder.names() else "is empty"
        raise InputError(
            f"{folder} {what}; expected a dataset folder: make one with "
            f"`prolearn dataset --preset demo --out {folder}`."
        )
    try:
        document = json.loads(folder.read(MANIFEST))
        schema = document.pop("schema")
        if schema != SCHEMA:
            raise InputError(
                f"{folder} has schema {schema}, of another version of prolearn; expected "
                f"{SCHEMA}: make the dataset anew in another folder, or remove this one."
            )
        return TypeAdapter(Manifest).validate_python(document)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{MANIFEST} in {folder} is damaged ({_fault(error)}); delete it and give the command "
            "that made the dataset again: shards that are sound are kept."
        ) from error


def write_manifest(folder: Folder, manifest: Manifest) -> None:
    """Write the manifest, whole."""
    document = {"schema": SCHEMA, **asdict(manifest)}
    for part in ("samples", "shards"):
        document[part] = dict(sorted(document[part].items()))
    folder.publish(MANIFEST, (json.dumps(document, indent=1) + "\n").encode())


def under_way(
    folder: Folder, begun: Callable[[], Manifest]
) -> AbstractContextManager[Ledger[Manifest]]:
    """The ledger of a dataset that is held for writing; arguments as of ``written``."""
    return written(folder, begun, write_manifest)


def _fault(error: Exception) -> str:
    return first_fault(error) if isinstance(error, ValidationError) else repr(error)
