"""Both stages of a dataset, shard by shard: scenarios are drawn, and the expert plans them."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, replace

import numpy as np
import pyarrow as pa

from pipeline.dataset import schema
from pipeline.dataset.manifest import (
    OWNED,
    TOP_LEVEL,
    MadeWith,
    Manifest,
    Shard,
    is_begun,
    read_manifest,
    recorded,
    requirements_of,
    settings_of,
)
from pipeline.dataset.samples import Sample
from pipeline.errors import InputError
from pipeline.expert import Settings, solve_many
from pipeline.files import refuse_dataset
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust import ALONG_AXES
from pipeline.parallel.workers import ALL_CORES, Workers, check_worker
from pipeline.plan.plan import SOLVED, Plan
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements
from pipeline.progress import SILENT
from pipeline.provenance import DecidedBy, made_with, refuse_change, refuse_other_versions
from pipeline.scenario import Scenario, draw, draw_many
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.ledger import Ledger, NewShard, open_ledger, sole_writer, write_shards
from pipeline.storage.shards import decode, digest_of, encode, has_metadata

# Code of ours and packages that the bytes of scenarios depend on
SAMPLED_BY: DecidedBy = ("pipeline/orbit", "pipeline/scenario"), ("numpy", "scipy", "pyarrow")
# Code of ours and packages that the bytes of plans depend on
SOLVED_BY: DecidedBy = (
    tuple(f"pipeline/{part}" for part in ("orbit", "scenario", "plan", "expert")),
    ("numpy", "scipy", "pyarrow", "clarabel", "highspy"),
)


def sample(
    where: Where | Folder,
    samples: Mapping[int, Sample],
    problem: Problem,
    *,
    workers: Workers = ALL_CORES,
) -> Manifest:
    """Draw samples, by swarm size, into a new folder or one begun with the same settings.

    Present shards are kept. InputError for settings that cannot be sampled or differ from those of
    the folder; ProlearnError where it cannot be written to or workers are killed repeatedly.
    """
    folder = open_folder(where)
    if folder.local:
        refuse_dataset(folder.local)
    if problem.thrust != ALONG_AXES:
        raise InputError(
            "the problem has thrusters of its own or constraints on burns, and a dataset has no "
            "columns for them; expected a problem without thrust: max_acceleration limits each "
            "component."
        )
    for n, by in samples.items():
        draw(by.family, by.seed, n, 0, problem)  # refuses bad settings before anything exists
    Manifest(problem, dict(samples), {}, MadeWith({}, {}), {})  # likewise
    foreign = [name for name in folder.top() if not TOP_LEVEL.fullmatch(name)]
    if foreign and not is_begun(folder):
        raise InputError(
            f"{folder} holds other files ({foreign[0]}) and no dataset; expected a new or an "
            "empty folder."
        )
    with sole_writer(folder, OWNED):
        manifest = _begin_sampling(folder, samples, problem)
        with open_ledger(folder, manifest.fields(), workers.progress) as ledger:
            missing = [s for s in manifest.expected() if not ledger.is_sound(s.scenarios)]
            write_shards(ledger, draw_shard, missing, workers)
    return replace(manifest, shards=ledger.shards)


def _begin_sampling(folder: Folder, samples: Mapping[int, Sample], problem: Problem) -> Manifest:
    """The manifest to write; InputError where the folder was begun with other settings."""
    versions = made_with(*SAMPLED_BY)
    if not is_begun(folder):
        return Manifest(problem, dict(samples), {}, MadeWith(versions, {}), {})
    manifest = read_manifest(folder)
    refuse_change(str(folder), manifest.problem.document(), problem.document())
    for n, by in samples.items():
        if n in manifest.samples:
            refuse_change(f"{folder} at n={n}", asdict(manifest.samples[n]), asdict(by))
    refuse_other_versions(f"{folder} was sampled", manifest.made_with.sample, versions)
    return replace(manifest, samples={**manifest.samples, **samples})


def draw_shard(shard: Shard, _: bytes) -> NewShard:
    """In a worker: the scenario shard; the solved one is dropped where the scenarios changed."""
    return NewShard(shard.scenarios, encode(drawn_table(shard)), derived=shard.solved)


def drawn_table(shard: Shard) -> pa.Table:
    """The scenarios of a shard, drawn; ProlearnError where other versions began the dataset."""
    manifest, by = shard.manifest, shard.sample
    check_worker(manifest.made_with.sample, SAMPLED_BY)
    drawn = by.drawn_as(shard.rows)
    scenarios = draw_many(by.family, by.seed, shard.n, drawn, manifest.problem)
    splits = [split for split, _ in drawn]
    return schema.scenario_table(scenarios, splits, shard.metadata(shard.scenarios))


def refuse_versions(what: object, manifest: Manifest) -> None:
    """Raise InputError, naming the first version in use that did not begin the dataset."""
    made = manifest.made_with
    refuse_other_versions(f"{what} was sampled", made.sample, made_with(*SAMPLED_BY))
    if manifest.solve:
        versions = made_with(*SOLVED_BY)
        refuse_other_versions(f"{what} was solved", made.solve, versions)


def solve(
    where: Where | Folder,
    settings: Settings,
    requirements: Requirements = AT_ALL_TIMES,
    *,
    workers: Workers = ALL_CORES,
) -> Manifest:
    """Solve the unsolved shards of a sampled dataset; damaged shards are made again.

    InputError where there is no dataset, another process writes to it, or it was begun with other
    settings; ProlearnError as in ``sample``.
    """
    folder = open_folder(where)
    read_manifest(folder)  # before the lock, which would make a folder
    with sole_writer(folder, OWNED):
        manifest = _begin_solving(folder, settings, requirements)
        with open_ledger(folder, manifest.fields(), workers.progress) as ledger:
            complete(manifest, ledger, workers)
    return replace(manifest, shards=ledger.shards)


def complete(
    manifest: Manifest, ledger: Ledger, workers: Workers, spared: Collection[str] = ()
) -> None:
    """Draw or solve what is missing or damaged, except for the shards of files in ``spared``."""
    shards = [s for s in manifest.expected() if not {s.scenarios, s.solved} & {*spared}]
    missing = [s for s in shards if not ledger.is_sound(s.scenarios)]
    if missing:
        drawn = f"Scenario shards that are missing or damaged are drawn again: {len(missing)}."
        workers.progress.say(drawn)
        write_shards(ledger, draw_shard, missing, workers.with_progress(SILENT))
    if manifest.solve:
        unsolved = [s for s in shards if not _is_solved(ledger, s)]
        unsolved.reverse()  # the largest swarms, which take longest, first
        write_shards(ledger, _solve_shard, unsolved, workers, lambda shard: shard.scenarios)


def _begin_solving(folder: Folder, settings: Settings, requirements: Requirements) -> Manifest:
    """The manifest to write; InputError where solving was begun with other settings."""
    manifest, now = read_manifest(folder), recorded(settings, requirements)
    if manifest.solve:
        refuse_change(str(folder), manifest.solve, now)
    refuse_versions(folder, manifest)
    versions = made_with(*SOLVED_BY)
    return replace(manifest, solve=now, made_with=replace(manifest.made_with, solve=versions))


def _is_solved(ledger: Ledger, shard: Shard) -> bool:
    """Whether a shard is solved and sound; intact ones of a killed run are adopted."""
    name, folder = shard.solved, ledger.folder

    def fits(table: pa.Table) -> bool:
        if not has_metadata(table, shard.metadata(name)):
            return False
        return schema.same_scenarios(table, decode(folder.read(shard.scenarios), shard.most))

    if name in ledger.shards or not folder.exists(name):
        return ledger.is_sound(name)
    return ledger.adopt(name, shard.most, fits)


def _solve_shard(shard: Shard, content: bytes) -> NewShard:
    how = shard.manifest.solve
    check_worker(shard.manifest.made_with.solve, SOLVED_BY)
    table = decode(content, shard.most)
    plans = _plans(schema.scenarios_of(table), settings_of(how), requirements_of(how))
    solved = encode(schema.solved_table(table, plans, shard.metadata(shard.solved)))
    timings = encode(schema.timing_table(table, plans, digest_of(solved)))
    failed = sum(isinstance(plan, str) or plan.status != SOLVED for plan in plans)
    return NewShard(shard.solved, solved, timings, failed=failed)


def _plans(
    scenarios: Sequence[Scenario], settings: Settings, requirements: Requirements
) -> list[Plan | str]:
    """Plans, or why there is none: failing arithmetic costs one plan, other errors end the run."""
    try:
        plans = solve_many(scenarios, settings=settings, requirements=requirements)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        if len(scenarios) == 1:
            return [f"the expert failed: {error!r}"]
        return [plan for s in scenarios for plan in _plans([s], settings, requirements)]
    overflowed = [p.status == SOLVED and not np.isfinite(p.states).all() for p in plans]
    why = "the plan has states that are not finite numbers"
    return [why if over else plan for plan, over in zip(plans, overflowed, strict=True)]
