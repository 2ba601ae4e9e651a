"""Scenarios and plans as rows: what is written, what is refused, what is read back."""

import json
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from contents import content
from forged import forge, remove
from typer.testing import CliRunner

from cli.main import app
from pipeline.dataset import making as stage
from pipeline.dataset.making import sample, solve
from pipeline.dataset.manifest import most_rows, read_manifest
from pipeline.dataset.reading import solved_examples, solved_rows
from pipeline.dataset.samples import Sample
from pipeline.dataset.schema import SOLVED_FIELDS, scenarios_of, stacked
from pipeline.dataset.verifying import verify
from pipeline.errors import InputError, ProlearnError
from pipeline.expert import Settings, solve_many
from pipeline.expert import solve as solve_scenario
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust import Thrust
from pipeline.parallel.workers import Workers
from pipeline.plan.requirements import Requirements
from pipeline.scenario import draw
from pipeline.storage import COPY, MANIFEST
from pipeline.storage.folder import Folder
from pipeline.storage.shards import METADATA_KEY, encode

ONE = Workers(jobs=1)


def test_rows_are_the_scenarios_that_draw_gives_and_the_plans_that_the_expert_gives(solved):
    table = solved_rows(solved, 3)
    states = stacked(table, "states", 3, 11, 6)
    for k, scenario in enumerate(scenarios_of(table)):
        drawn = draw("rings", 5, 3, [*range(5), 0][k], Problem(), [*["train"] * 5, "valid"][k])
        assert scenario.name == drawn.name
        assert np.array_equal(scenario.initial, drawn.initial)
        assert np.array_equal(scenario.goal, drawn.goal)
        assert np.array_equal(states[k], solve_scenario(drawn).states)


def test_the_schema_is_the_published_one_and_carries_the_problem(solved):
    schema = pq.read_schema(solved / "n=3/part-00000.parquet")
    assert schema.names == [field.name for field in SOLVED_FIELDS]
    about = json.loads(schema.metadata[METADATA_KEY])
    assert (about["nodes"], about["time_step"], about["collision_radius"]) == (11, 120.0, 15.0)
    assert (about["separation"], about["seed"], about["family"]) == ("continuous", 5, "rings")
    assert about["max_acceleration"] is None


def test_splits_follow_each_other_with_their_shares_and_are_numbered_anew():
    one = Sample(count=1000, shares=(0.7, 0.2, 0.1))
    drawn = [row for k in range(one.shards) for row in one.drawn_as(one.rows(k))]
    assert [split for split, _ in drawn] == ["train"] * 700 + ["valid"] * 200 + ["test"] * 100
    assert [index for _, index in drawn] == [*range(700), *range(200), *range(100)]


@pytest.mark.parametrize(
    ("shares", "shards"),
    [
        # Rows 0 to 19, 20 to 39 and so on, of which the splits end at these rows.
        ((0.8, 0.1, 0.1), ["train", "train", "train", "train valid", "valid test"]),  # 76, 86
        ((0.5, 0.0, 0.5), ["train", "train", "train test", "test", "test"]),  # 48, 48
        ((0.0, 0.0, 1.0), ["test"] * 5),
        ((0.5, 0.5, 0.0), ["train", "train", "train valid", "valid", "valid"]),  # 48, 95
    ],
)
def test_a_shard_has_the_splits_of_its_rows(shares, shards):
    one = Sample(count=95, shares=shares, shard_rows=20)
    assert [one.splits_of(k) for k in range(one.shards)] == [set(s.split()) for s in shards]


def test_shards_hold_every_row_once():
    one = Sample(count=95, shard_rows=20)
    assert [k for s in range(one.shards) for k in one.rows(s)] == list(range(95))


def test_no_test_scenario_of_any_dataset_is_a_training_scenario_of_another(tmp_path):
    """Datasets of the same seed whose sizes and shares put other rows into their splits."""
    samples = {
        "small": Sample(count=20, shares=(0.5, 0.2, 0.3)),
        "large": Sample(count=60, shares=(0.8, 0.1, 0.1)),
        "tests": Sample(count=12, shares=(0.0, 0.0, 1.0)),
    }
    ends = {"train": set(), "valid": set(), "test": set()}
    for name, one in samples.items():
        sample(tmp_path / name, {4: one}, Problem(), workers=ONE)
        table = pq.read_table(tmp_path / name / "_scenarios/n=4")
        for split, initial, goal in zip(*table.select(["split", "initial", "goal"]), strict=True):
            ends[split.as_py()].add((*initial.as_py(), *goal.as_py()))
    assert (len(ends["train"]), len(ends["valid"]), len(ends["test"])) == (48, 6, 12)
    assert not (ends["train"] & ends["test"] or ends["train"] & ends["valid"])
    assert not ends["valid"] & ends["test"]


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"count": 0}, "count is 0"),
        ({"seed": -1}, "seed is -1"),
        ({"seed": 2**32}, "expected a number from 0 to 4294967295"),
        ({"shard_rows": 0}, "rows in a shard is 0"),
        ({"shares": (0.5, 0.5, 0.5)}, "add up to 1"),
        ({"shares": (1.2, -0.1, -0.1)}, "0 or more"),
    ],
    ids=str,
)
def test_a_sample_that_cannot_be_drawn_is_refused(change, word):
    with pytest.raises(InputError, match=word):
        Sample(**change)


@pytest.mark.parametrize(
    ("samples", "problem", "words"),
    [
        ({2: Sample(count=8, shard_rows=3)}, Problem(), "count = 7, now it is 8"),
        ({3: Sample(count=6, shard_rows=3, seed=6)}, Problem(), "seed = 5, now it is 6"),
        ({4: Sample(count=2)}, Problem(nodes=7), "nodes = 11, now it is 7"),
    ],
    ids=["count", "seed", "nodes"],
)
def test_other_settings_are_refused_by_name_with_both_values(solved, samples, problem, words):
    before = content(solved)
    with pytest.raises(InputError, match=words):
        sample(solved, samples, problem, workers=ONE)
    assert content(solved) == before


def test_another_way_to_solve_is_refused_by_name_with_both_values(solved):
    before = content(solved)
    with pytest.raises(InputError, match="separation = continuous, now it is nodes"):
        solve(solved, Settings(), Requirements("nodes"), workers=ONE)
    assert content(solved) == before


def test_another_size_joins_a_folder_and_leaves_the_others_alone(solved):
    before = content(solved)
    sample(solved, {4: Sample(count=2)}, Problem(), workers=ONE)
    solve(solved, Settings(), workers=ONE)
    after = content(solved)
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {"_manifest.json", "_manifest.copy.json"}
    assert len(solved_rows(solved, 4)) == 2


@pytest.mark.parametrize(
    "thrust", [Thrust("norm"), Thrust(min_delta_v=0.01), Thrust(no_burn=((0.0, 300.0),))], ids=str
)
def test_thrusters_that_no_column_shows_are_refused_before_anything_is_made(thrust, tmp_path):
    with pytest.raises(InputError, match="expected a problem without thrust"):
        sample(tmp_path / "data", {2: Sample(count=2)}, Problem(thrust=thrust), workers=ONE)
    assert not (tmp_path / "data").exists()


def test_a_folder_with_other_files_is_refused(tmp_path):
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(InputError, match=r"letter\.txt"):
        sample(tmp_path, {2: Sample(count=1)}, Problem(), workers=ONE)
    assert [p.name for p in tmp_path.iterdir()] == ["letter.txt"]


def test_every_scenario_has_a_row_and_failures_reach_no_training(tmp_path):
    # A thrust limit that some transfers can keep to and others cannot.
    weak = Problem(max_acceleration=7e-4)
    sample(
        tmp_path,
        {2: Sample(count=24, shares=(1.0, 0.0, 0.0), shard_rows=12)},
        weak,
        workers=Workers(jobs=1),
    )
    solve(tmp_path, Settings(), workers=ONE)
    table = solved_rows(tmp_path, 2)
    statuses = table["status"].to_pylist()
    failed = [k for k, status in enumerate(statuses) if status != "solved"]
    assert len(table) == 24
    assert 0 < len(failed) < 24
    assert all(table["states"][k].as_py() is None for k in failed)
    learnt = solved_examples(tmp_path, 2, "train")
    assert len(learnt) == 24 - len(failed)
    assert np.isfinite(learnt.states).all()
    initial = stacked(table, "initial", 2, 6)
    assert np.array_equal(learnt.initial, np.delete(initial, failed, axis=0))


def breaking(error):
    """The expert, but for the second scenario."""

    def breaks_down(scenarios, **told):
        if any(scenario.name.endswith("1") for scenario in scenarios):
            raise error
        return solve_many(scenarios, **told)

    return breaks_down


def test_arithmetic_that_breaks_down_costs_one_row_and_says_why(tmp_path, monkeypatch):
    error = np.linalg.LinAlgError("singular matrix")
    monkeypatch.setattr(stage, "solve_many", breaking(error))
    sample(
        tmp_path, {2: Sample(count=3, shares=(1.0, 0.0, 0.0))}, Problem(), workers=Workers(jobs=1)
    )
    solve(tmp_path, Settings(), workers=ONE)
    assert solved_rows(tmp_path, 2)["status"].to_pylist() == ["solved", "unsolved", "solved"]
    timings = pq.read_table(tmp_path / "_timings/n=2/part-00000.parquet")
    assert "singular matrix" in timings["message"][1].as_py()


@pytest.mark.parametrize("kind", [AttributeError, ValueError, TypeError, RuntimeError])
def test_a_programming_error_ends_the_run_and_gives_no_row(tmp_path, monkeypatch, kind):
    monkeypatch.setattr(stage, "solve_many", breaking(kind("a slip of the pen")))
    sample(
        tmp_path, {2: Sample(count=3, shares=(1.0, 0.0, 0.0))}, Problem(), workers=Workers(jobs=1)
    )
    done = CliRunner().invoke(app, ["solve", str(tmp_path), "--jobs", "1"])
    assert done.exit_code == 1
    assert isinstance(done.exception, kind)
    assert not list(tmp_path.glob("n=2/*"))


def test_stacked_columns_are_the_rows_one_by_one(solved):
    table = solved_rows(solved, 3)
    controls = stacked(table, "controls", 3, 10, 3)
    for k in range(len(table)):
        assert np.array_equal(controls[k], np.reshape(table["controls"][k].as_py(), (3, 10, 3)))
    some = table.filter([k % 2 == 0 for k in range(len(table))])
    assert np.array_equal(stacked(some, "controls", 3, 10, 3), controls[::2])


def test_examples_are_the_rows_of_their_split(solved):
    whole, train = solved_rows(solved, 2), solved_examples(solved, 2, "train")
    wanted = [k for k, split in enumerate(whole["split"].to_pylist()) if split == "train"]
    assert len(train) == len(wanted) == 6
    assert np.array_equal(train.states, stacked(whole, "states", 2, 11, 6)[wanted])
    assert (train.n, train.problem) == (2, Problem())


def test_what_is_not_there_is_said_with_what_to_do(solved, tmp_path):
    with pytest.raises(InputError, match=r"does not exist.*prolearn dataset"):
        read_manifest(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"prolearn dataset --preset demo --out '[^']* else'`"):
        read_manifest(tmp_path / "somewhere else")
    (tmp_path / "bare").mkdir()
    with pytest.raises(InputError, match="is empty"):
        read_manifest(tmp_path / "bare")
    with pytest.raises(InputError, match=r"n=9.*expected n in 2, 3"):
        solved_rows(solved, 9)
    with pytest.raises(InputError, match="no solved instance of n=3 in its test split"):
        (tmp_path / "x").mkdir()
        sample(
            tmp_path / "x",
            {3: Sample(count=2, shares=(1.0, 0.0, 0.0))},
            Problem(),
            workers=Workers(jobs=1),
        )
        solve(tmp_path / "x", Settings(), workers=ONE)
        solved_examples(tmp_path / "x", 3, "test")
    with pytest.raises(InputError, match=r"no scenarios of n=5; expected n = 3\.$"):
        solved_rows(tmp_path / "x", 5)
    (solved / "n=3/part-00001.parquet").unlink()
    with pytest.raises(InputError, match=r"part-00001\.parquet in .* cannot be read .* --repair"):
        solved_rows(solved, 3)


@pytest.mark.parametrize(
    ("damage", "fault"),
    [
        (lambda document: document.pop("made_with"), "made_with is missing"),
        (lambda document: document.pop("schema"), "KeyError\\('schema'\\)"),
        (lambda document: document["samples"]["2"].update(count="many"), r"2\.count is 'many': "),
        (lambda document: document["samples"]["2"].update(orbits=3), r"2\.orbits is not a field"),
        (lambda document: document["problem"].update(orbits=3), "orbits"),
        (lambda document: document["problem"].update(nodes=[]), r"nodes: "),
        (lambda document: document["solve"].update(separation="far"), "separation is 'far'"),
        (lambda document: document["samples"]["2"].update(family="cubes"), "family is 'cubes'"),
        (lambda document: document["samples"]["2"].update(count=10**9), "at most 200000"),
        (lambda document: document["samples"].update({"0": {}}), "greater than 0"),
        (lambda document: document["shards"].update(x=1), r"shards\.x is 1: "),
        (lambda document: document.update(more=1), "more is not a field"),
    ],
)
def test_a_manifest_with_a_field_that_is_wrong_is_damaged_and_says_where(solved, damage, fault):
    forge(solved, damage)
    with pytest.raises(InputError, match=rf"is damaged \(.*{fault}.*\); delete it and"):
        read_manifest(solved)


WHOLE = """
import sys
from pathlib import Path
from pipeline.dataset.making import sample
from pipeline.dataset.making import solve
from pipeline.dataset.verifying import verify
from pipeline.parallel.workers import Workers
from pipeline.dataset.samples import Sample
from pipeline.expert import Settings
from pipeline.orbit.problem import Problem

folder, one = Path(sys.argv[1]), Workers(jobs=1)
shards = [folder / "n=2/part-00000.parquet", folder / "_scenarios/n=2/part-00000.parquet"]
sample(folder, {2: Sample(count=2)}, Problem(time_step=90, collision_radius=10), workers=one)
solve(folder, Settings(), workers=one)
before = [path.read_bytes() for path in shards]
for path in shards:
    path.unlink()
solve(folder, Settings(), workers=one)
assert [path.read_bytes() for path in shards] == before
assert list(verify(folder, workers=one)) == []
"""


def test_whole_numbers_of_a_problem_stay_whole_so_that_shards_made_again_are_the_same(tmp_path):
    """In a process of its own, where no argument's type is checked."""
    command = [sys.executable, "-c", WHOLE, str(tmp_path)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr


def test_a_damaged_manifest_is_made_again_and_sound_plans_are_kept(solved):
    before = content(solved)
    times = {p: p.stat().st_mtime_ns for p in solved.glob("n=*/*.parquet")}
    for name in (MANIFEST, COPY):
        (solved / name).write_text("{")
    with pytest.raises(InputError, match=r"damaged .*; delete it and give the command that made"):
        read_manifest(solved)
    (solved / MANIFEST).unlink()
    again = {2: Sample(count=7, shard_rows=3), 3: Sample(count=6, shard_rows=3, seed=5)}
    sample(solved, again, Problem(), workers=ONE)
    solve(solved, Settings(), workers=ONE)
    assert content(solved) == before
    assert times == {p: p.stat().st_mtime_ns for p in solved.glob("n=*/*.parquet")}


def test_plans_of_other_settings_are_not_adopted(solved, tmp_path):
    sample(
        tmp_path / "other", {2: Sample(count=7, shard_rows=3)}, Problem(), workers=Workers(jobs=1)
    )
    solve(tmp_path / "other", Settings(), Requirements("nodes"), workers=ONE)
    remove(solved)
    name = "n=2/part-00000.parquet"
    right = (solved / name).read_bytes()
    (solved / name).write_bytes((tmp_path / "other" / name).read_bytes())
    sample(solved, {2: Sample(count=7, shard_rows=3)}, Problem(), workers=ONE)
    solve(solved, Settings(), workers=ONE)
    assert (solved / name).read_bytes() == right


def test_files_that_are_too_large_to_be_checked_are_refused_before_anything_is_made(tmp_path):
    folder, most = tmp_path / "data", most_rows(10, Problem())
    message = rf"a file of {most + 1} scenarios of n=10 is too large .*--rows-per-shard .* {most}\."
    with pytest.raises(InputError, match=message):
        sample(folder, {10: Sample(count=most + 9, shard_rows=most + 1)}, Problem(), workers=ONE)
    assert not folder.exists()
    # A shard of a million rows that has but some
    sample(folder, {10: Sample(count=2, shard_rows=10**6)}, Problem(), workers=ONE)


@pytest.mark.parametrize(("n", "nodes"), [(1, 3), (10, 11), (100, 4)])
def test_the_largest_files_fit_into_what_is_read(n, nodes):
    """Rows whose numbers no compression makes smaller, with the longest of names."""
    problem, rng, rows = Problem(nodes=nodes), np.random.default_rng(0), 200_000 // (n * nodes)
    shapes = {"initial": 6, "goal": 6, "states": 6 * nodes, "controls": 3 * (nodes - 1)}

    def values(name, kind):
        if name in shapes:
            return [*rng.random((rows, n * shapes[name]))]
        if kind == pa.string():
            return [f"coplanar-split-s4294967295-n1000-train-{k:010d}" for k in range(rows)]
        return rng.integers(2**31, size=rows) if kind == pa.int32() else rng.random(rows)

    arrays = [pa.array(values(one.name, one.type), one.type) for one in SOLVED_FIELDS]
    table = pa.Table.from_arrays(arrays, schema=pa.schema(SOLVED_FIELDS))
    assert len(encode(table)) / rows < 2**31 / most_rows(n, problem)


def test_workers_that_cannot_be_are_refused():
    with pytest.raises(InputError, match="jobs is 0"):
        Workers(jobs=0)


def test_a_scheduler_that_does_not_answer_is_named(solved, monkeypatch):
    monkeypatch.setattr("pipeline.parallel.cluster.CONNECT_SECONDS", 0.5)
    (solved / "n=3/part-00001.parquet").unlink()
    far = Workers(scheduler="tcp://127.0.0.1:1")
    with pytest.raises(ProlearnError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:1"):
        solve(solved, Settings(), workers=far)


def test_what_has_not_changed_is_not_read_again_and_what_has_is(solved, monkeypatch):
    read, real = [], Folder.read

    def noted(folder, name):
        read.append(name)
        return real(folder, name)

    def again():
        read.clear()
        sample(solved, {2: Sample(count=7, shard_rows=3)}, Problem(), workers=ONE)
        solve(solved, Settings(), workers=ONE)
        return {name for name in read if name.endswith(".parquet")}

    monkeypatch.setattr(Folder, "read", noted)
    assert again() == set()
    path = solved / "n=3/part-00000.parquet"
    path.write_bytes(path.read_bytes())
    assert again() == {"n=3/part-00000.parquet"}
    read.clear()
    assert list(verify(solved, workers=ONE)) == []
    assert sum(name.endswith(".parquet") for name in read) == 3 * 5  # scenarios, plans, timings
