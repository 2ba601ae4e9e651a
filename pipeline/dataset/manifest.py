"""The manifest of a dataset folder: what it is meant to hold, and the SHA-256 of every shard.

Beside what any folder of shards has (pipeline/storage), a dataset holds

    FOLDER/n=10/part-00000.parquet               solved instances
    FOLDER/_scenarios/n=10/part-00000.parquet    the scenarios they come from
    FOLDER/README.md                             the card, for people and dataset hubs
    FOLDER/.git/, FOLDER/.gitattributes, ...     of tools that keep the folder; left alone
"""

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any

from pydantic import AfterValidator, ConfigDict, PositiveInt, ValidationError, WrapValidator

from pipeline.dataset.samples import Sample
from pipeline.dataset.schema import FAMILY, SCHEMA, metadata
from pipeline.documents import first_fault, validated
from pipeline.errors import InputError
from pipeline.expert import Settings
from pipeline.orbit.problem import Problem
from pipeline.plan.requirements import Requirements
from pipeline.scenario.families import scenario_id
from pipeline.storage import COPY, DAMAGED, FOREIGN, LOCK, MANIFEST, TIMINGS, WRITTEN
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.ledger import read_checked
from pipeline.storage.shards import Size
from pipeline.text import as_argument

CARD = "README.md"
SCENARIOS = "_scenarios/"
SHARD = re.compile(rf"({SCENARIOS}|{TIMINGS})?n=\d+/part-\d{{5,}}\.parquet")  # names of shards
OWNED = rf"{SHARD.pattern}|{re.escape(CARD)}"  # pattern of the files that a dataset's writers make
# Files that a dataset may hold besides its shards
OTHER_FILES = re.compile(
    rf"{WRITTEN}|{LOCK}|({FOREIGN}|{DAMAGED}).*|{re.escape(CARD)}|(.*/)?\..*", re.DOTALL
)
# Files and folders directly inside the folder of a dataset
TOP_LEVEL = re.compile(
    rf"{OTHER_FILES.pattern}|n=\d+|{SCENARIOS}?|{TIMINGS}?|{FOREIGN}?|{DAMAGED}?", re.DOTALL
)
MOST_SHARDS = 200_000  # in a folder; their list alone takes a second to make
MOST_BYTES = 2**31  # of a shard, which is read whole to be checked; most have some MB
NUMBER_BYTES, TEXT_BYTES = 9, 256  # the most that a number and the rest of a row take in a shard
OTHERS = "is no dataset's"  # fault of a manifest that other files have
REQUIRED = ("separation", "passive_safety")  # requirements recorded with the expert's settings


def most_rows(n: int, problem: Problem) -> int:
    """The most rows of a shard that takes at most MOST_BYTES once it is solved."""
    numbers = 9 * n * (problem.nodes + 1)  # states, controls and ends
    return MOST_BYTES // (numbers * NUMBER_BYTES + TEXT_BYTES)


def recorded(settings: Settings, requirements: Requirements) -> Mapping[str, Any]:
    """The record of settings and requirements; InputError for a risk, which no column shows."""
    if requirements.risk is not None:
        raise InputError(
            "the requirements have a risk, and plans of a dataset are flown without errors; "
            "expected requirements without one."
        )
    return asdict(settings) | {name: getattr(requirements, name) for name in REQUIRED}


def settings_of(record: Mapping[str, Any]) -> Settings:
    """The settings of the expert in a record; ValueError or TypeError where there are none."""
    given = {name: value for name, value in record.items() if name not in REQUIRED}
    return validated(Settings, given) and Settings(**given)


def requirements_of(record: Mapping[str, Any]) -> Requirements:
    """The requirements of plans in a record; ValueError where no plan can satisfy them."""
    given = {name: record[name] for name in REQUIRED if name in record}
    return validated(Requirements, given) and Requirements(**given)


def _checked_record(given: Mapping[str, Any]) -> Mapping[str, Any]:
    try:
        settings_of(given), requirements_of(given)
    except ValidationError as error:
        raise ValueError(first_fault(error)) from None
    except TypeError as error:  # an unknown name
        raise ValueError(str(error)) from None
    return given


@dataclass(frozen=True)
class MadeWith:
    """Versions, by name, of code and packages that sampled a dataset, and that solved it."""

    sample: Mapping[str, str]
    solve: Mapping[str, str]


@dataclass(frozen=True)
class Manifest:
    """What a dataset folder shall hold and which shards are finished; laid out as in the file."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    # As written: an integer stays one, since the metadata of shards repeats it to the letter.
    problem: Annotated[Problem, WrapValidator(lambda fields, of: of(fields) and Problem.of(fields))]
    samples: Mapping[PositiveInt, Sample]  # how each swarm size is drawn
    # Record of how plans are made, or nothing before the first solve.
    solve: Annotated[Mapping[str, Any], AfterValidator(_checked_record)]
    made_with: MadeWith
    shards: Mapping[str, str]  # SHA-256 of each finished shard, by path inside the folder

    def __post_init__(self) -> None:
        shards = sum(sample.shards for sample in self.samples.values())
        if shards > MOST_SHARDS:
            raise InputError(
                f"its samples take {shards} shards; expected at most {MOST_SHARDS}: draw fewer "
                "scenarios into one folder."
            )
        for n, sample in self.samples.items():
            rows, most = len(sample.rows(0)), most_rows(n, self.problem)
            if rows > most:
                raise InputError(
                    f"a file of {rows} scenarios of n={n} is too large to be checked; expected "
                    f"--rows-per-shard of at most {most}."
                )

    def fields(self) -> dict[str, Any]:
        """Fields of its file, JSON-ready."""
        fields = {"schema": SCHEMA, **asdict(self), "problem": self.problem.document()}
        return {**fields, "samples": dict(sorted(fields["samples"].items()))}

    def expected(self) -> "list[Shard]":
        """All shards that it shall hold, in order."""
        about, sizes = replace(self, shards={}), sorted(self.samples.items())
        numbers = [(n, k) for n, sample in sizes for k in range(sample.shards)]
        return [Shard(about, *one, self.shards.get(shard_path(*one), "")) for one in numbers]

    def digest(self, n: int | None = None) -> str:
        """Digest of the solved data, all or of one swarm size."""
        top = "n=" if n is None else f"n={n}/"
        solved = {p: d for p, d in self.shards.items() if p.startswith(top)}
        return hashlib.sha256(json.dumps(solved, sort_keys=True).encode()).hexdigest()


def shard_path(n: int, number: int) -> str:
    """Path of a shard of solved instances inside the folder of its dataset."""
    return f"n={n}/part-{number:05d}.parquet"


@dataclass(frozen=True)
class Shard:
    """Some rows of a dataset, with all that determines them."""

    manifest: Manifest  # without its digests, which make it large
    n: int  # swarm size
    number: int  # which of that size's shards
    digest: str  # of its solved instances; empty where they are not in the manifest

    @property
    def sample(self) -> Sample:
        """How its scenarios are drawn."""
        return self.manifest.samples[self.n]

    @property
    def rows(self) -> range:
        """Its rows, counted over the whole sample."""
        return self.sample.rows(self.number)

    @property
    def scenario_ids(self) -> list[str]:
        """Names of its scenarios, in order."""
        by = self.sample
        drawn = by.drawn_as(self.rows)
        return [scenario_id(by.family, by.seed, self.n, k, split) for split, k in drawn]

    @property
    def most(self) -> Size:
        """The largest size of its files."""
        return Size(len(self.rows), len(self.rows) * self.n * 6 * self.manifest.problem.nodes)

    @property
    def solved(self) -> str:
        """Path of its solved instances inside the folder."""
        return shard_path(self.n, self.number)

    @property
    def scenarios(self) -> str:
        """Path of the scenarios that they come from."""
        return SCENARIOS + self.solved

    def metadata(self, path: str) -> dict[bytes, bytes]:
        """The schema metadata of a file of it, the scenarios' or that of the solved instances."""
        manifest, sample = self.manifest, self.sample
        origin = {"seed": sample.seed, "family": sample.family}
        if path == self.scenarios:
            return metadata(manifest.problem, origin, manifest.made_with.sample)
        settings = origin | dict(manifest.solve)
        return metadata(manifest.problem, settings, manifest.made_with.solve)


def read_manifest(where: Where | Folder) -> Manifest:
    """The manifest of a dataset; InputError where it is damaged or there is no dataset."""
    folder = open_folder(where)
    manifest, fault = manifest_or_copy(folder)
    if fault:
        raise InputError(
            f"{MANIFEST} in {folder} {fault}, and its copy is sound; mend it with "
            f"`prolearn verify {as_argument(folder)} --repair`."
        )
    return manifest


def is_begun(folder: Folder) -> bool:
    """Whether a folder has a dataset's manifest, or only its copy."""
    return folder.exists(MANIFEST) or isinstance(_parsed(folder, COPY), Manifest)


def manifest_or_copy(folder: Folder) -> tuple[Manifest, str]:
    """The manifest and '', or its copy and the manifest's fault; InputError where both are bad."""
    found = _parsed(folder, MANIFEST)
    if isinstance(found, Manifest):
        return found, ""
    copy = _parsed(folder, COPY)
    if isinstance(copy, Manifest):
        return copy, found
    if found.startswith(OTHERS):
        raise InputError(f"{MANIFEST} in {folder} {found}; expected one: give another folder.")
    if folder.exists(MANIFEST):
        raise InputError(
            f"{MANIFEST} in {folder} {found}; delete it and give the command that made the dataset "
            "again: shards that are sound are kept."
        )
    what = "is a file" if folder.local and folder.local.is_file() else "does not exist"
    if folder.names():  # ProlearnError where a server is not reached
        what = "holds no dataset"
    elif folder.is_present():
        what = "is empty"
    raise InputError(
        f"{folder} {what}; expected a dataset folder: make one with "
        f"`prolearn dataset --preset demo --out {as_argument(folder)}`."
    )


def _parsed(folder: Folder, name: str) -> Manifest | str:
    """The manifest in a file, or what is wrong with it; InputError for one of another version."""
    if not folder.exists(name):
        return "is missing"
    try:
        document = read_checked(folder, name)
        schema = document.pop("schema")
        if schema == SCHEMA:
            return validated(Manifest, document)
        if not str(schema).startswith(FAMILY):
            return f"{OTHERS} (its schema is {schema})"
    except ValidationError as error:
        return f"is damaged ({first_fault(error)})"
    except (OSError, ValueError, KeyError, TypeError, InputError) as error:
        fault = repr(error) if isinstance(error, KeyError) else str(error).rstrip(".")
        return f"is damaged ({fault})"
    raise InputError(
        f"{folder} has schema {schema}, of another version of prolearn; expected {SCHEMA}: make "
        "the dataset anew in another folder, or remove this one."
    )
