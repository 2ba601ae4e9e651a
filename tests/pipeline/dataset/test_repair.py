"""Repair destroys nothing that is sound, says what it takes away, and keeps it."""

import random
import shutil
import stat
from pathlib import Path

import pytest
from contents import content
from forged import forge
from rights import bound_by_modes
from sentences import Sentences

from pipeline.dataset.making import sample, solve
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.samples import Sample
from pipeline.dataset.verifying import repair, verify
from pipeline.errors import InputError
from pipeline.expert import Settings
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers
from pipeline.storage import COPY, MANIFEST, TIMED

ONE = Workers(jobs=1)
SHARD = "n=3/part-00001.parquet"


def faults(folder):
    return list(verify(folder, workers=ONE))


def rows(folder):
    """Every file of rows inside a folder, with its content."""
    paths = [path for path in folder.rglob("*.parquet*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


@pytest.mark.parametrize("name", [MANIFEST, COPY])
def test_a_flipped_bit_of_the_manifest_is_a_fault_and_mended_by_its_copy(tmp_path, name):
    sample(tmp_path, {3: Sample(count=2)}, Problem(), workers=ONE)
    solve(tmp_path, Settings(), workers=ONE)
    before, chance = content(tmp_path), random.Random(name)
    whole = (tmp_path / name).read_bytes()
    for _ in range(12):
        damaged = bytearray(whole)
        damaged[chance.randrange(len(whole))] ^= 1 << chance.randrange(8)
        (tmp_path / name).write_bytes(damaged)
        assert name in {fault.path for fault in faults(tmp_path)}
        repair(tmp_path, workers=ONE)
        assert content(tmp_path) == before
        assert faults(tmp_path) == []


def test_a_damaged_manifest_stops_work_with_what_to_do(solved):
    (solved / MANIFEST).write_text("{")
    with pytest.raises(InputError, match=r"mend it with `prolearn verify .* --repair`"):
        solve(solved, Settings(), workers=ONE)


@pytest.mark.parametrize("names", [[MANIFEST], [COPY], [TIMED], [COPY, TIMED], [MANIFEST, TIMED]])
def test_a_missing_document_is_a_fault_and_made_again_without_solving(solved, names):
    before, times = content(solved), {p: p.stat().st_mtime_ns for p in solved.rglob("*.parquet")}
    for name in names:
        (solved / name).unlink()
    assert set(names) <= {fault.path for fault in faults(solved)}
    repair(solved, workers=ONE)
    assert content(solved) == before
    assert faults(solved) == []
    assert times == {p: p.stat().st_mtime_ns for p in solved.rglob("*.parquet")}


@pytest.mark.parametrize("swapped", [False, True])
def test_the_datasets_manifest_in_the_place_of_that_of_timings_is_a_fault(solved, swapped):
    before, timed = content(solved), (solved / TIMED).read_bytes()
    (solved / TIMED).write_bytes((solved / MANIFEST).read_bytes())
    if swapped:
        (solved / MANIFEST).write_bytes(timed)
    assert {TIMED, *([MANIFEST] * swapped)} <= {fault.path for fault in faults(solved)}
    repair(solved, workers=ONE)
    assert content(solved) == before
    assert faults(solved) == []


FORGERIES = {
    "time_step": lambda manifest: manifest["problem"].update(time_step=122.0),
    "gap_tolerance": lambda manifest: manifest["solve"].update(gap_tolerance=2e-3),
    "seed": lambda manifest: manifest["samples"]["3"].update(seed=6),
    "count": lambda manifest: manifest["samples"]["2"].update(count=3),
    "shares": lambda manifest: manifest["samples"]["3"].update(shares=[0.5, 0.25, 0.25]),
    "rows": lambda manifest: manifest["samples"]["2"].update(shard_rows=4),
    "sizes": lambda manifest: manifest["samples"].pop("2"),
    "digests": lambda manifest: manifest["shards"].update({SHARD: "0" * 64}),
}


@pytest.mark.parametrize("change", FORGERIES.values(), ids=FORGERIES.keys())
def test_a_manifest_that_shards_contradict_costs_no_sound_row(solved, change):
    """With a checksum that is right, as of another dataset's manifest."""
    before = rows(solved)
    forge(solved, change)
    found = repair(solved, workers=ONE)
    after = rows(solved)
    assert found
    assert all(after[fault.path] == before[fault.path] for fault in found if fault.sound)
    data = {name: content for name, content in before.items() if "_timings" not in name}
    assert {*data.values()} <= {*after.values()}
    assert {*data} <= {*after}, "nothing is moved, unasked"


def test_nothing_is_solved_again_once_the_right_manifest_is_back(solved, monkeypatch):
    """Timings stay with the rows that are left alone, though the wrong manifest fits neither."""
    before, right = rows(solved), (solved / MANIFEST).read_bytes()
    forge(solved, lambda manifest: manifest["samples"]["3"].update(seed=6))
    left = {fault.path for fault in repair(solved, workers=ONE) if fault.sound}
    assert {f"{top}{SHARD}" for top in ("", "_scenarios/", "_timings/")} <= left
    assert rows(solved) == before
    for name in (MANIFEST, COPY):
        (solved / name).write_bytes(right)
    monkeypatch.setattr("pipeline.dataset.making.solve_many", None)
    assert repair(solved, workers=ONE) == []
    solve(solved, Settings(), workers=ONE)
    assert rows(solved) == before


def test_sound_rows_that_are_not_expected_go_only_when_asked_for_and_are_kept(solved, tmp_path):
    twin = Path(shutil.copytree(solved, tmp_path / "twin"))
    forge(solved, lambda manifest: manifest["problem"].update(time_step=122.0))
    assert [fault.sound for fault in repair(solved, workers=ONE)].count(True) == 10
    heard = Sentences()
    repair(solved, yes=True, workers=ONE.with_progress(heard))
    assert faults(solved) == []
    assert read_manifest(solved).problem.time_step == 122.0
    aside = {name: content for name, content in rows(solved).items() if "_damaged/" in name}
    data = {content for name, content in rows(twin).items() if "_timings" not in name}
    assert {*aside.values()} >= data
    assert all(any(name in said for said in heard.said) for name in aside)


def test_a_damaged_shard_is_kept_beside_the_one_that_took_its_place(solved):
    def again(folder, progress):
        solve(folder, Settings(), workers=ONE.with_progress(progress))

    def mend(folder, progress):
        repair(folder, workers=ONE.with_progress(progress))

    for k, run in enumerate((mend, again), start=1):
        damaged = (solved / SHARD).read_bytes()[: -100 * k]
        (solved / SHARD).write_bytes(damaged)
        heard = Sentences()
        run(solved, heard)
        assert (solved / f"_damaged/{SHARD}.{k}").read_bytes() == damaged
        assert heard.said == [f"{SHARD} in {solved} is set aside as _damaged/{SHARD}.{k}."]
        assert faults(solved) == []


def test_a_shard_that_nobody_may_read_is_a_fault_and_made_again(solved):
    before = content(solved)
    (solved / SHARD).chmod(0)
    with bound_by_modes():
        assert [(f.path, f.what[:14]) for f in faults(solved)] == [(SHARD, "cannot be read")]
        assert [fault.path for fault in repair(solved, workers=ONE)] == [SHARD]
        assert faults(solved) == []
        assert content(solved) == before
    assert stat.S_IMODE((solved / f"_damaged/{SHARD}.1").stat().st_mode) == 0


def swapped(path):
    other = path.with_name("part-00000.parquet")
    mine, theirs = path.read_bytes(), other.read_bytes()
    path.write_bytes(theirs)
    other.write_bytes(mine)


def flipped(path):
    content = bytearray(path.read_bytes())
    content[-60] ^= 1  # in the footer, which no page's checksum is about
    path.write_bytes(content)


@pytest.mark.parametrize("damage", [swapped, flipped, Path.unlink], ids=lambda f: f.__name__)
def test_timings_that_are_swapped_damaged_or_gone_are_a_fault_and_come_back(solved, damage):
    before, path = content(solved), solved / "_timings" / SHARD
    damage(path)
    found = {fault.path for fault in faults(solved)}
    names = {f"_timings/{SHARD}", "_timings/n=3/part-00000.parquet"}
    assert found == (names if damage is swapped else {f"_timings/{SHARD}"})
    repair(solved, workers=ONE)
    assert path.exists()
    assert faults(solved) == []
    assert content(solved) == before


def test_timings_of_another_run_of_the_same_rows_are_adopted(solved, tmp_path, monkeypatch):
    """As of two runs at once on an object store, which has no lock."""
    twin = Path(shutil.copytree(solved, tmp_path / "twin"))
    shutil.rmtree(twin / "n=3")
    solve(twin, Settings(), workers=ONE)
    other = (twin / "_timings" / SHARD).read_bytes()
    assert other != (solved / "_timings" / SHARD).read_bytes()
    (solved / "_timings" / SHARD).write_bytes(other)
    assert [fault.what[:9] for fault in faults(solved)] == ["is intact"]
    monkeypatch.setattr("pipeline.dataset.making.solve_many", None)
    repair(solved, workers=ONE)
    assert faults(solved) == []
    assert (solved / "_timings" / SHARD).read_bytes() == other
    assert not (solved / "_damaged").exists()


def test_timings_gone_as_a_whole_are_a_fault_and_come_back(solved):
    before = content(solved)
    shutil.rmtree(solved / "_timings")
    assert len(faults(solved)) == 5 + 1
    repair(solved, workers=ONE)
    assert faults(solved) == []
    assert content(solved) == before


def test_flipped_bits_of_footers_are_faults_and_mended(solved):
    """Three shards are damaged at once; each is verified and repaired independently."""
    before, chance = content(solved), random.Random(0)
    names = (SHARD, "_scenarios/n=3/part-00000.parquet", "_timings/n=2/part-00001.parquet")
    for _ in range(12):
        for name in names:
            damaged = bytearray((solved / name).read_bytes())
            length = int.from_bytes(damaged[-8:-4], "little") + 8
            damaged[-1 - chance.randrange(length)] ^= 1 << chance.randrange(8)
            (solved / name).write_bytes(damaged)
        found = {fault.path: fault.sound for fault in faults(solved)}
        assert found == dict.fromkeys(names, False)
        repair(solved, workers=ONE)
        assert content(solved) == before
        assert faults(solved) == []
