"""Damage of every kind is found by name and mended, and nothing else is touched."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from contents import content
from judge import judge_dataset

from pipeline.dataset.making import sample, solve
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.schema import metadata, scenario_table
from pipeline.dataset.verifying import is_sound_shard, repair, verify
from pipeline.expert import Settings
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements
from pipeline.scenario import Scenario
from pipeline.storage import COPY, MANIFEST
from pipeline.storage.folder import open_folder
from pipeline.storage.ledger import write_checked
from pipeline.storage.shards import digest_of, encode

ONE = Workers(jobs=1)
SHARD = "n=3/part-00001.parquet"


def flipped(path):
    """A byte in the middle of the pages, which Parquet alone would not miss."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x10
    path.write_bytes(content)


def truncated(path):
    path.write_bytes(path.read_bytes()[:-100])


def emptied(path):
    path.write_bytes(b"")


def swapped(path):
    """A sound shard in the wrong place."""
    path.write_bytes(path.with_name("part-00000.parquet").read_bytes())


DAMAGE = [flipped, truncated, emptied, swapped, Path.unlink]


def found(folder):
    return {(fault.path, fault.what) for fault in verify(folder, workers=ONE)}


def test_a_sound_dataset_has_no_faults(solved):
    assert found(solved) == set()


def test_scenarios_alone_can_be_verified_and_mended(tmp_path):
    from pipeline.dataset.samples import Sample

    sample(tmp_path, {2: Sample(count=4, shard_rows=2)}, Problem(), workers=ONE)
    before = content(tmp_path)
    assert found(tmp_path) == set()
    truncated(tmp_path / "_scenarios/n=2/part-00001.parquet")
    assert {path for path, _ in found(tmp_path)} == {"_scenarios/n=2/part-00001.parquet"}
    repair(tmp_path, workers=ONE)
    assert content(tmp_path) == before


@pytest.mark.parametrize("damage", DAMAGE, ids=lambda f: f.__name__)
@pytest.mark.parametrize("name", [SHARD, "_scenarios/" + SHARD])
@pytest.mark.parametrize("mended_by", ["repair", "solve"])
def test_damage_is_named_and_exactly_that_shard_is_done_again(solved, damage, name, mended_by):
    before = content(solved)
    damage(solved / name)
    others = [p for p in solved.rglob("*.parquet") if p != solved / name and "_tim" not in str(p)]
    times = {p: p.stat().st_mtime_ns for p in others}
    assert {path for path, _ in found(solved)} == {name}
    if mended_by == "repair":
        # What is swapped is sound rows of another shard, which want to be given up by name.
        faults = repair(solved, yes=damage is swapped, workers=ONE)
        assert [fault.path for fault in faults] == [name]
    else:
        solve(solved, Settings(), workers=ONE)
    assert content(solved) == before
    assert times == {p: p.stat().st_mtime_ns for p in others}
    assert found(solved) == set()


def test_damaged_timings_are_named_and_made_again(solved):
    before = content(solved)
    truncated(solved / "_timings" / SHARD)
    assert {path for path, _ in found(solved)} == {"_timings/" + SHARD}
    repair(solved, workers=ONE)
    assert found(solved) == set()
    assert content(solved) == before


def test_foreign_files_are_named_and_moved_out_of_the_readers_way(solved):
    foreign = ["n=3/part-00009.parquet", "notes.txt", "n=7/part-00000.parquet"]
    for name in foreign:
        (solved / name).parent.mkdir(exist_ok=True)
        (solved / name).write_bytes((solved / SHARD).read_bytes())
    assert found(solved) == {(name, "does not belong to this dataset") for name in foreign}
    repair(solved, yes=True, workers=ONE)
    assert found(solved) == set()
    assert all((solved / "_foreign" / f"{name}.1").exists() for name in foreign)
    assert pq.read_table(solved).num_rows == 13


@pytest.mark.parametrize("name", [".git/x", "n=3/.DS_Store", "_scenarios/n=3/.nfs000000c100000002"])
def test_hidden_files_of_others_are_no_faults_and_stay(solved, name):
    (solved / name).parent.mkdir(exist_ok=True)
    (solved / name).touch()
    assert found(solved) == set()
    repair(solved, yes=True, workers=ONE)
    assert (solved / name).exists()
    assert pq.read_table(solved).num_rows == 13


def forge(folder, change, name=SHARD):
    """Change a shard and give the manifest its new digest, as only a bug of ours could."""
    path = folder / name
    table = pq.read_table(path, partitioning=None)
    columns = {name: table[name].to_pylist() for name in table.column_names}
    change(columns)
    arrays = [pa.array(columns[f.name], f.type) for f in table.schema]
    content = encode(pa.Table.from_arrays(arrays, schema=table.schema))
    path.write_bytes(content)
    manifest = read_manifest(folder)
    shards = {**manifest.shards, name: digest_of(content)}
    write_checked(open_folder(folder), MANIFEST, replace(manifest, shards=shards).fields(), COPY)


def moved(columns):
    columns["states"][1][6] += 1e-3  # x of the first craft at its second node


def pushed(columns):
    columns["controls"][1][0] += 1e-6


def other_goal(columns):
    columns["goal"][1][0] += 1e-3


def cheap(columns):
    columns["fuel"][1] *= 0.999


def bound_above_fuel(columns):
    columns["fuel_lower_bound"][1] = columns["fuel"][1] * 1.01


def apart(columns):
    columns["min_separation"][1] += 0.1


def hit(columns):
    columns["node_collisions"][1] += 1


def unflown(columns):
    columns["states"][1] = None


def no_number(columns):
    columns["states"][1][9] = float("nan")


def no_fuel(columns):
    columns["fuel_lower_bound"][1] = 0.0  # the gap stays


def less_than_none(columns):
    fuel = columns["fuel"][1]
    columns["fuel_lower_bound"][1], columns["optimality_gap"][1] = -fuel, float("inf")


def uncounted(columns):
    columns["convex_solves"][1] = None


def counted_down(columns):
    columns["convex_solves"][1] = -5


def touching(columns):
    columns["min_separation"][1] = None


def without_plan(columns, *kept):
    gone = ("states", "controls", "fuel", "fuel_lower_bound", "optimality_gap", "node_collisions")
    for name in {*gone, "min_separation"} - {*kept}:
        columns[name][1] = None


def banana(columns):
    without_plan(columns)
    columns["status"][1] = "banana"


def infeasible(columns):
    without_plan(columns, "min_separation")
    columns["status"][1] = "infeasible"


def given_up(columns):
    without_plan(columns)
    columns["status"][1] = "infeasible"


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (moved, "breaks the dynamics"),
        (pushed, "breaks the dynamics"),
        (other_goal, "misses an end"),
        (cheap, "claims a fuel other than that of its controls"),
        (bound_above_fuel, "has less fuel than its lower bound"),
        (apart, "claims a least separation other than that of its states"),
        (hit, "claims node collisions other than those of its states"),
        (unflown, "has missing values, or values that its status excludes"),
        (no_number, "breaks the dynamics"),
        (no_fuel, "claims a gap other than that of its fuel"),
        (less_than_none, "has a lower bound that is not 0 or more"),
        (uncounted, "has missing values, or values that its status excludes"),
        (counted_down, "has a negative number of convex programs"),
        (touching, "has missing values, or values that its status excludes"),
        (banana, "has none of the statuses solved, infeasible, unsolved, unsafe"),
        (infeasible, "has missing values, or values that its status excludes"),
        (given_up, "is not proven to be infeasible"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_row_that_physics_contradicts_is_named_and_made_again(solved, change, what):
    before = content(solved)
    forge(solved, change)
    assert (SHARD, f"rings-s5-n3-train-000004 {what}") in found(solved)
    repair(solved, workers=ONE)
    assert content(solved) == before


def test_a_lower_bound_that_a_cheaper_transfer_contradicts_is_found(tmp_path):
    from pipeline.dataset.samples import Sample

    sample(tmp_path, {6: Sample(count=4, family="dense")}, Problem(), workers=ONE)
    solve(tmp_path, Settings(), workers=ONE)
    gap = pq.read_table(tmp_path)["optimality_gap"].to_numpy()
    assert (gap > 1e-4).any()
    assert found(tmp_path) == set()

    def optimal(columns):
        columns["fuel_lower_bound"] = columns["fuel"]
        columns["optimality_gap"] = [0.0] * len(gap)

    shard = "n=6/part-00000.parquet"
    forge(tmp_path, optimal, shard)
    told = [what for path, what in found(tmp_path) if path == shard]
    assert len(told) == (gap > 1e-8).sum()
    assert all("above the fuel of its decoupled optima" in what for what in told)


def repeated(columns):
    for name in columns.keys() - {"scenario_id", "split"}:
        columns[name][1] = columns[name][0]


def relabelled(columns):
    """The second row, its craft in another order throughout."""
    for name in ("initial", "goal", "states", "controls"):
        craft = np.reshape(columns[name][1], (3, -1))
        columns[name][1] = np.roll(craft, 1, axis=0).ravel()


def one_more(columns):
    columns["n_spacecraft"][1] = 4


def another_family(columns):
    columns["family"][1] = "dense"


def five_metres(columns):
    columns["goal"][1][0] += 5.0


def nowhere(columns):
    columns["goal"][1][0] = float("nan")


def uneven(columns):
    columns["goal"][0].append(columns["goal"][1].pop(0))


OTHER = "has other scenarios than the manifest expects"
SIZES, FAMILIES = "has rows of other swarm sizes than 3", "has rows of other families than rings"


@pytest.mark.parametrize(
    ("change", "name", "what"),
    [
        (repeated, SHARD, {OTHER}),
        (relabelled, SHARD, {OTHER}),
        (one_more, SHARD, {OTHER, SIZES}),
        (another_family, SHARD, {OTHER, FAMILIES}),
        (one_more, "_scenarios/" + SHARD, {OTHER, SIZES}),
        (another_family, "_scenarios/" + SHARD, {OTHER, FAMILIES}),
        (five_metres, "_scenarios/" + SHARD, {OTHER}),
        (
            nowhere,
            "_scenarios/" + SHARD,
            {OTHER, "has initial or goal states that are not finite numbers"},
        ),
        (uneven, "_scenarios/" + SHARD, {OTHER, "has initial or goal states of another shape"}),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_rows_of_other_scenarios_than_were_drawn_are_found_where_they_are(
    solved, change, name, what
):
    """And made again, though digests, and the physics of each row, are right."""
    before = content(solved)
    forge(solved, change, name)
    assert {fault for fault in found(solved) if "_timings" not in fault[0]} == {
        (name, one) for one in what
    }
    repair(solved, workers=ONE)
    assert content(solved) == before
    assert found(solved) == set()


def test_rows_of_other_scenarios_are_found_by_other_versions_too(solved, monkeypatch):
    """Which cannot draw them, and so cannot say whether plans or scenarios are wrong."""
    forge(solved, five_metres, "_scenarios/" + SHARD)
    monkeypatch.setattr("pipeline.dataset.making.SAMPLED_BY", (("pipeline/orbit",), ("numpy",)))
    assert found(solved) == {(SHARD, f"has other scenarios than _scenarios/{SHARD}")}


def test_a_large_shard_of_another_dataset_is_known_to_hold_sound_rows():
    n, rng, about = 1000, np.random.default_rng(0), metadata(Problem(), {}, {})
    # Again only after more than is compressed at once, and so often that a byte had several numbers
    swarms = 12 * [Scenario(Problem(), *rng.random((2, n, 6)), "rings", "") for _ in range(34)]
    assert is_sound_shard(encode(scenario_table(swarms, ["test"] * len(swarms), about)))


def test_plans_that_pass_too_close_are_found_between_nodes_too(tmp_path):
    """Plans kept apart at the nodes alone, judged by the continuous criterion."""
    from pipeline.dataset.physics import row_faults
    from pipeline.dataset.reading import solved_rows
    from pipeline.dataset.samples import Sample
    from pipeline.orbit.dynamics import cw_matrices

    sample(tmp_path, {10: Sample(count=8)}, Problem(), workers=ONE)
    solve(tmp_path, Settings(), Requirements("nodes"), workers=ONE)
    table = solved_rows(tmp_path, 10)
    named = {
        int(fault.split()[0][-6:])
        for fault in row_faults(table, 10, Problem(), AT_ALL_TIMES)
        if fault.endswith("comes too close")
    }
    problem, close = Problem(), set()
    A, B = cw_matrices(problem.mean_motion, np.linspace(0, problem.time_step, 241))
    for k in range(len(table)):
        states = np.reshape(table["states"][k].as_py(), (10, 11, 6))[:, :-1]
        controls = np.reshape(table["controls"][k].as_py(), (10, 10, 3))
        dense = np.einsum("qij,ntj->ntqi", A, states) + np.einsum("qij,ntj->ntqi", B, controls)
        i, j = np.triu_indices(10, 1)
        if np.linalg.norm((dense[i] - dense[j])[..., :3], axis=-1).min() <= 15.0:
            close.add(k)
    assert named == close
    assert 0 < len(close) < 8
    assert found(tmp_path) == set()


def test_an_independent_judge_finds_every_row_sound(solved):
    report = judge_dataset(solved)
    assert report.faults == ()
    assert report.statuses == {"solved": 13}


def test_an_independent_judge_finds_every_row_sound_where_some_have_no_plan(tmp_path):
    from pipeline.dataset.samples import Sample

    sample(tmp_path, {4: Sample(count=24)}, Problem(max_acceleration=7e-4), workers=ONE)
    solve(tmp_path, Settings(), workers=ONE)
    report = judge_dataset(tmp_path)
    assert report.faults == ()
    assert set(report.statuses) == {"solved", "infeasible"}
    assert found(tmp_path) == set()
