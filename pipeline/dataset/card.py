"""The card of a dataset: README.md with front matter, columns, origin, splits, quality, limits."""

import json
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from dataclasses import replace as replaced
from functools import partial
from itertools import accumulate, groupby
from typing import Any

import pandas as pd
import pyarrow as pa
import yaml

from pipeline.dataset.manifest import (
    CARD,
    Manifest,
    Shard,
    read_manifest,
    recorded,
    requirements_of,
)
from pipeline.dataset.reading import decode_solved, refuse_unsolved, shard_named
from pipeline.dataset.samples import PRESETS, Sample
from pipeline.dataset.schema import COLUMNS, SOLVED_FIELDS, DataColumn
from pipeline.errors import InputError
from pipeline.expert import Settings
from pipeline.markup import Markdown, code, formatted, table, template, verbatim
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import R_EARTH, mean_motion_at, radius_at
from pipeline.parallel.workers import ALL_CORES, Workers
from pipeline.plan.plan import SOLVED
from pipeline.plan.requirements import AT_ALL_TIMES
from pipeline.scenario import SPLITS
from pipeline.scenario.families import FAMILIES
from pipeline.scenario.part_documents import OrbitDocument
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.shards import read_verified
from pipeline.storage.shared import work_on

HUB_NAMES = dict(zip(SPLITS, ("train", "validation", "test"), strict=True))  # of splits on hubs
DEFAULT = "default"  # the configuration that is loaded where none is named: all swarm sizes
# Hubs' categories of size, with the number of rows that each stays below
SIZES = {"n<1K": 1e3, "1K<n<10K": 1e4, "10K<n<100K": 1e5, "100K<n<1M": 1e6, "1M<n<10M": 1e7}
LARGEST = "10M<n<100M"

TAGS = [
    "astrodynamics",
    "spacecraft",
    "formation-flying",
    "swarm",
    "trajectory-optimization",
    "motion-planning",
    "convex-optimization",
]

LICENCE = "mit"  # of data that come with prolearn: the project's own
IDENTIFIER = re.compile(r"[a-z0-9][a-z0-9.-]*")  # how hubs write the name of a licence
REBUILT = "data/again"  # folder in the commands that make the dataset again
OPTIONS = ("separation", "solver")  # settings of the expert that `prolearn solve` has
# Columns that the card has numbers of
SUMMARIZED = ["n_spacecraft", "split", "status", "fuel", "optimality_gap", "min_separation"]
# Values of states in a task of a worker: 20 MB, which it reads in 0.1 s
VALUES_PER_TASK = 2_000_000
FEW_TASKS = 40  # below so many, starting processes takes longer than reading here
QUANTILES = (0.5, 0.9, 0.99, 1.0)  # of the optimality gap
TYPED_DIGITS = range(-3, 7)  # decimals of an altitude in m that a person may have typed


@dataclass(frozen=True)
class File:
    """The file of a solved shard, with its number of rows and its sizes."""

    shard: Shard
    rows: int
    file_bytes: int
    memory_bytes: int  # as an Arrow table


def files_by_split(files: Sequence[File]) -> dict[str, list[File]]:
    """Files by the name, on hubs, of the split of their rows.

    On hubs a file belongs to one split, so splits that share a file are merged, and named such as
    ``validation_test``.
    """
    splits = {file.shard.solved: file.shard.sample.splits_of(file.shard.number) for file in files}
    found: dict[str, list[File]] = {}
    for group in _partition(splits.values()):
        name = "_".join(HUB_NAMES[split] for split in SPLITS if split in group)
        found[name] = [file for file in files if splits[file.shard.solved] <= group]
    return found


def _partition(sets: Iterable[set[str]]) -> list[set[str]]:
    """The finest partition of the splits in which each set lies in one part, in order."""
    parts: list[set[str]] = []
    for members in sets:
        disjoint = [part for part in parts if not part & members]
        parts = [*disjoint, members.union(*(part for part in parts if part & members))]
    return sorted(parts, key=lambda part: min(map(SPLITS.index, part)))


def front_matter(files: Sequence[File], title: str, licence: str) -> str:
    """The front matter as YAML, without the ``---`` lines around it."""
    rows = sum(file.rows for file in files)
    return yaml.safe_dump(
        {
            "license": licence,
            "pretty_name": title,
            "task_categories": ["robotics"],
            "tags": TAGS,
            "size_categories": [next((k for k, below in SIZES.items() if rows < below), LARGEST)],
            "configs": _configurations(files),
            "dataset_info": [_dataset_info(files)],
        },
        sort_keys=False,
        allow_unicode=True,
        width=100,
    )


def _configurations(files: Sequence[File]) -> list[Mapping[str, Any]]:
    """The configuration of all files, and one for each swarm size where there are several."""
    by_n = {f"n{n}": some for n, some in _by_size(files)}
    configs = {DEFAULT: files} | (by_n if len(by_n) > 1 else {})
    found = {name: files_by_split(some).items() for name, some in configs.items()}
    paths = {k: [{"split": s, "path": list(_paths(f))} for s, f in v] for k, v in found.items()}
    return [{"config_name": name, "data_files": data} for name, data in paths.items()]


def _paths(files: Sequence[File]) -> Iterator[str]:
    for n, some in _by_size(files):
        is_all = len(some) == some[0].shard.sample.shards
        yield from [f"n={n}/*.parquet"] if is_all else [file.shard.solved for file in some]


def _by_size(files: Sequence[File]) -> Iterator[tuple[int, list[File]]]:
    for n, some in groupby(files, key=lambda file: file.shard.n):
        yield n, list(some)


def _dataset_info(files: Sequence[File]) -> Mapping[str, Any]:
    return {
        "config_name": DEFAULT,
        "features": [_feature(field) for field in SOLVED_FIELDS],
        "splits": [
            {
                "name": split,
                "num_bytes": sum(file.memory_bytes for file in some),
                "num_examples": sum(file.rows for file in some),
            }
            for split, some in files_by_split(files).items()
        ],
        "download_size": sum(file.file_bytes for file in files),
        "dataset_size": sum(file.memory_bytes for file in files),
    }


def _feature(field: pa.Field) -> Mapping[str, str]:
    """A column with its type as hubs name it: as Arrow does, except for float64 (double)."""
    key, kind = "dtype", field.type
    if pa.types.is_list(kind):
        key, kind = "list", kind.value_type
    return {"name": field.name, key: "float64" if pa.types.is_float64(kind) else str(kind)}


def write_card(
    where: Where | Folder,
    *,
    licence: str = LICENCE,
    replace: bool = False,
    workers: Workers = ALL_CORES,
) -> str:
    """Write the card of a solved dataset into its folder: Markdown with front matter.

    The licence is an identifier such as "mit" or "cc-by-4.0"; with ``replace`` a README.md with
    other content is overwritten. InputError for such a file otherwise, for a dataset that is
    damaged or not wholly solved, or no licence; ProlearnError where workers are killed repeatedly.
    """
    if not IDENTIFIER.fullmatch(licence):
        raise InputError(
            f"licence is {licence!r}; expected an identifier such as mit or cc-by-4.0."
        )
    folder = open_folder(where)
    text = _card_text(folder, licence, workers)
    present = folder.read(CARD) if folder.exists(CARD) else None
    if present == text.encode():
        return text
    if present is not None and not replace:
        raise InputError(
            f"{folder} has a {CARD} that says something else; move what you wrote there out of "
            "the way, or replace it with --force."
        )
    folder.publish(CARD, text.encode())
    return text


def _card_text(folder: Folder, licence: str, workers: Workers) -> str:
    manifest = read_manifest(folder)
    files, rows = _contents(folder, manifest.expected(), workers)
    name = folder.local.resolve().name if folder.local else str(folder).rstrip("/").split("/")[-1]
    quoted = json.dumps(name, ensure_ascii=False)
    title = f"Certified transfers of spacecraft swarms, n = {ranges(sorted(manifest.samples))}"
    joined = [code(split) for split in files_by_split(files) if "_" in split]
    body = template("pipeline/dataset/card.md.jinja").render(
        title=title,
        quoted=verbatim(quoted),
        one_size=f'load_dataset({quoted}, "n{min(manifest.samples)}")',
        licence=licence,
        problem=manifest.problem,
        orbit=_orbit(manifest.problem),
        at_nodes=requirements_of(manifest.solve).at_nodes,
        sizes=sorted(manifest.samples),
        mebibytes=sum(file.file_bytes for file in files) / 2**20,
        joined=Markdown(", ".join(joined)),
        solved=SOLVED,
        columns=table(("column", "type", "unit", "meaning"), map(_column, COLUMNS)),
        **_origin(manifest),
        **_quality(rows),
    )
    return f"---\n{front_matter(files, title, licence)}---\n\n{body}"


def _column(column: DataColumn) -> tuple[Markdown, str, str, Markdown]:
    kind = f"list of {column.shape} doubles" if column.shape else str(column.type)
    return code(column.name), kind, column.unit, Markdown(column.meaning)


def _contents(
    folder: Folder, shards: Sequence[Shard], workers: Workers
) -> tuple[list[File], pd.DataFrame]:
    """The files of a dataset's shards in order, and the SUMMARIZED columns of all their rows."""
    refuse_unsolved(folder, shards)
    workers.progress.expect(sum(len(shard.rows) for shard in shards))
    tasks = _tasks(shards)
    if workers.jobs == -1 and len(tasks) < FEW_TASKS:
        workers = replaced(workers, jobs=1)
    found: list[tuple[File, pa.Table]] = []
    summarized = partial(_summarized, str(folder))
    with closing(work_on(folder, workers, summarized, tasks, _read)) as results:
        for _, files_read in results:
            found += files_read
            workers.progress.done(sum(file.rows for file, _ in files_read))
    found.sort(key=lambda pair: (pair[0].shard.n, pair[0].shard.number))
    files, tables = zip(*found, strict=True)
    return list(files), pa.concat_tables(tables).to_pandas()


def _tasks(shards: Sequence[Shard]) -> list[list[Shard]]:
    """All shards in order, grouped in a way that does not depend on the workers."""
    ends = accumulate(shard.most.values for shard in shards)
    groups = groupby(zip(shards, ends, strict=True), lambda pair: pair[1] // VALUES_PER_TASK)
    return [[shard for shard, _ in group] for _, group in groups]


def _read(folder: Folder, shards: Sequence[Shard]) -> list[bytes]:
    found = []
    for shard in shards:
        with shard_named(shard, str(folder)):
            found.append(read_verified(folder, shard.solved, shard.digest))
    return found


def _summarized(
    folder: str, shards: Sequence[Shard], contents: Sequence[bytes]
) -> list[tuple[File, pa.Table]]:
    """In a worker: the file and the SUMMARIZED columns of each of some shards."""
    found = []
    for shard, content in zip(shards, contents, strict=True):
        with shard_named(shard, folder):  # one in memory at a time
            rows = decode_solved(content, shard)
        file = File(shard, rows.num_rows, len(content), rows.nbytes)
        found.append((file, rows.select(SUMMARIZED)))
    return found


def _origin(manifest: Manifest) -> Mapping[str, Any]:
    made, preset = manifest.made_with, preset_of(manifest)
    by_n = sorted(manifest.samples.items())
    sizes = {sample: [n for n, other in by_n if other == sample] for _, sample in by_n}
    draws = [
        (ranges(ns), sample.family, sample.seed, sample.count, *map(len, sample.splits.values()))
        for sample, ns in sizes.items()
    ]
    names = sorted({*made.sample, *made.solve})
    versions = [(name, made.sample.get(name, ""), made.solve.get(name, "")) for name in names]
    settings = (formatted("{} {}", code(name), value) for name, value in manifest.solve.items())
    usual = recorded(Settings(), AT_ALL_TIMES)
    chosen = [k for k, v in manifest.solve.items() if k not in OPTIONS and v != usual.get(k)]
    families = sorted({sample.family for sample in manifest.samples.values()})
    docs = {name: (draw.__doc__ or "").partition("\n")[0] for name, draw in FAMILIES.items()}
    return {
        "draws": table(("n", "family", "seed", "scenarios of each n", *SPLITS), draws),
        "families": {
            name: docs.get(name, "Of another version of prolearn.").replace(" (the default)", "")
            for name in families
        },
        "commands": list(commands(manifest, REBUILT)),
        "without_option": Markdown(", ".join(map(code, chosen))),
        "missing": ranges(sorted({*PRESETS.get(preset or "", {})} - {*manifest.samples})),
        "versions": table(("", "scenarios", "plans"), versions),
        "settings": Markdown(", ".join(settings)),
        "digest": manifest.digest(),
    }


def _quality(rows: pd.DataFrame) -> Mapping[str, Any]:
    numbers = []
    for n, of_size in rows.groupby("n_spacecraft"):
        plans = of_size[of_size["status"] == SOLVED]
        numbers.append(
            (
                str(n),
                f"{len(plans)} of {len(of_size)}",
                *_gaps(plans).values(),
                _number(plans["fuel"].mean(), "{:#.4g}"),
                _number(plans["min_separation"].min(), "{:.3f}"),
            )
        )
    head = ("n", "solved", "gap, median", "90 %", "99 %", "largest")
    return {
        "scenarios": len(rows),
        "statuses": ", ".join(f"{k} {name}" for name, k in rows["status"].value_counts().items()),
        "gaps": _gaps(rows[rows["status"] == SOLVED]),
        "quality": table((*head, "fuel, mean (m/s²)", "least separation (m)"), numbers),
    }


def _gaps(plans: pd.DataFrame) -> dict[float, str]:
    """Quantiles of the plans' optimality gap, in per cent, as text."""
    found = plans["optimality_gap"].quantile(list(QUANTILES))
    return {q: _number(100 * gap, "{:.3f} %") for q, gap in zip(QUANTILES, found, strict=True)}


def _number(value: float, form: str) -> str:
    return "" if pd.isna(value) else form.format(value).removesuffix(".")


def preset_of(manifest: Manifest) -> str | None:
    """The preset that all scenarios and plans are of, or None; sizes of it may be missing."""
    # A subset: settings that are newer than the dataset had their present default built in.
    default = manifest.solve.items() <= recorded(Settings(), AT_ALL_TIMES).items()
    if not default or manifest.problem != Problem():
        return None
    fitting = (k for k, preset in PRESETS.items() if manifest.samples.items() <= preset.items())
    return next(fitting, None)


def commands(manifest: Manifest, folder: str) -> Iterator[str]:
    """The command lines that make the same rows, except for settings that have no option."""
    preset = preset_of(manifest)
    if preset:
        yield f"prolearn dataset --preset {preset} --out {folder}"
        return
    for n, sample in sorted(manifest.samples.items()):
        options = " ".join(_options(sample, manifest.problem))
        yield f"prolearn sample --n {n} {options} --out {folder}"
    chosen = {name: str(manifest.solve[name]) for name in OPTIONS}
    how = " ".join(f"--{name} {shlex.quote(value)}" for name, value in chosen.items())
    yield f"prolearn solve {folder} {how}"


def _options(sample: Sample, problem: Problem) -> Iterator[str]:
    yield f"--count {sample.count} --seed {sample.seed} --family {shlex.quote(sample.family)}"
    yield f"--shares {','.join(map(str, sample.shares))} --rows-per-shard {sample.shard_rows}"
    if problem.orbit is None:
        yield f"--altitude {altitude_of(problem.mean_motion)}"
    else:
        yield f"--orbit {shlex.quote(json.dumps(OrbitDocument.of(problem.orbit).model_dump()))}"
    yield f"--time-step {problem.time_step} --nodes {problem.nodes}"
    yield f"--collision-radius {problem.collision_radius}"
    if problem.max_acceleration is not None:
        yield f"--max-acceleration {problem.max_acceleration}"


def _orbit(problem: Problem) -> str:
    orbit = problem.orbit
    if orbit is None:
        altitude = altitude_of(problem.mean_motion) / 1e3
        return (
            f"circular about the Earth, {altitude:.6g} km high (mean motion "
            f"{problem.mean_motion:.9g} rad/s)"
        )
    named = OrbitDocument.of(orbit).model_dump(exclude_none=True)
    return "by osculating elements, " + ", ".join(f"{k} {v}" for k, v in named.items())


def altitude_of(mean_motion: float) -> float:
    """Altitude in m of a mean motion in rad/s, with the fewest decimals that reproduce it."""
    exact = radius_at(mean_motion) - R_EARTH
    rounded = (round(exact, digits) for digits in TYPED_DIGITS)
    return next((value for value in rounded if mean_motion_at(value) == mean_motion), exact)


def ranges(numbers: Sequence[int]) -> str:
    """Ascending numbers as text, runs of them shortened.

    >>> ranges([2, 3, 4, 10, 60])
    '2 to 4, 10, 60'
    """
    # Along a run of consecutive numbers, number minus index stays the same.
    groups = groupby(enumerate(numbers), key=lambda pair: pair[1] - pair[0])
    runs = [[number for _, number in group] for _, group in groups]
    return ", ".join(f"{run[0]} to {run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)
