"""A Monte Carlo in a folder: the same bytes on any number of workers and after any kill."""

import hashlib
import json
import os
import shutil
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from kills import run_script

from pipeline.errors import InputError
from pipeline.expert import FIRST_SAFE, BackOff, solve
from pipeline.flight.errors import COLD_GAS, draws
from pipeline.flight.loops import Loop, TrialSettings, fly_loops
from pipeline.flight.montecarlo import fly_all
from pipeline.flight.trials import fly_trials, open_loop
from pipeline.flight.world import LinearWorld
from pipeline.networks.model import load
from pipeline.networks.refiner.model import FOLDER
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers
from pipeline.planners.classical import Expert
from pipeline.planners.named import named_planner
from pipeline.planners.network import NetworkPlanner
from pipeline.planners.planner import identity
from pipeline.scenario import draw

SCENARIO = draw("rings", 0, 3, 0, Problem(nodes=6), "test")
PLAN = solve(SCENARIO)
WORLD = LinearWorld(SCENARIO.problem.dynamics)
ERRORS = replace(COLD_GAS, lost=0.5)
OF = TrialSettings(SCENARIO, WORLD, ERRORS, seed=5, portion=4)
BACK_OFF = BackOff(ERRORS.gaussian(SCENARIO.problem.time_step), 2.0, closed_loop=True)
LOOPS = [
    Loop("open", PLAN.controls),
    Loop("replanned", PLAN.controls, planner=Expert(), back_off=BACK_OFF),
    Loop("feedback", PLAN.controls, PLAN.states),
]


def fly(folder, trials=10, of=OF, jobs=1, loops=LOOPS):
    return fly_all(folder, of, loops, trials, workers=Workers(jobs))


def content(folder):
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*.parquet"))
        if not {"_timings", "_damaged"} & {*path.parts}
    }


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trials")
    return folder, fly(folder)


def test_two_workers_write_the_same_bytes_as_one(undisturbed, tmp_path):
    fly(tmp_path, jobs=2)
    assert content(tmp_path) == content(undisturbed[0])
    assert len(content(tmp_path)) == len(LOOPS) * 3


def test_a_row_is_what_its_trial_flown_alone_comes_to(undisturbed):
    row = {name: values[7] for name, values in undisturbed[1]["open"].items() if len(values)}
    drawn = draws(5, range(7, 8), 3, 5)
    alone = fly_trials(SCENARIO, WORLD, open_loop(PLAN.controls), drawn, ERRORS)
    assert row["trial"] == 7
    assert row["goal_error"] == alone["goal_error"][0]
    assert row["delta_v"] == alone["delta_v"][0]
    assert row["min_separation"] == alone["min_separation"][0]
    assert (row["first_craft"], row["second_craft"]) == (
        alone["first_craft"][0],
        alone["second_craft"][0],
    )


def test_trials_in_memory_are_those_of_the_folder(undisturbed):
    found = fly_loops(replace(OF, portion=None), LOOPS, 10)
    for loop in LOOPS:
        for name, values in undisturbed[1][loop.name].items():
            if name != "replan_seconds":
                np.testing.assert_array_equal(found[loop.name][name], values)


def test_the_schema_says_how_trials_were_made(undisturbed):
    path = undisturbed[0] / "loop=replanned" / "part-00000.parquet"
    told = json.loads(pq.read_schema(path).metadata[b"prolearn"])
    assert told["errors"]["magnitude"] == ERRORS.magnitude
    assert (told["seed"], told["loop"], told["planner"]["name"]) == (5, "replanned", "expert")
    assert (told["back_off"]["sigmas"], told["world"]["name"]) == (2.0, "LinearWorld")
    assert told["collision_radius"] == 15.0
    assert {"prolearn", "numpy"} <= set(told["made_with"])


def test_more_trials_come_on_top_and_fewer_take_nothing_away(undisturbed, tmp_path):
    few = fly(tmp_path, trials=4)
    assert len(few["open"]["trial"]) == 4
    more = fly(tmp_path, trials=10)
    assert content(tmp_path) == content(undisturbed[0])
    for name, values in few["open"].items():
        np.testing.assert_array_equal(more["open"][name][: len(values)], values)
    again = fly(tmp_path, trials=6)
    assert content(tmp_path) == content(undisturbed[0])
    assert again["open"]["trial"].tolist() == list(range(6))


def test_a_shard_of_fewer_trials_is_replaced_and_not_set_aside(undisturbed, tmp_path):
    fly(tmp_path, trials=6)  # the second shard has two rows of four
    fly(tmp_path)
    assert content(tmp_path) == content(undisturbed[0])
    assert not (tmp_path / "_damaged").exists()


def test_what_is_there_is_not_flown_again_and_what_is_damaged_is(undisturbed, tmp_path):
    fly(tmp_path)
    paths = sorted(tmp_path.rglob("loop=*/part-*.parquet"))
    stamps = {path: path.stat().st_mtime_ns for path in paths}
    broken = tmp_path / "loop=open" / "part-00001.parquet"
    damaged = bytearray(broken.read_bytes())
    damaged[40] ^= 0xFF
    broken.write_bytes(damaged)
    fly(tmp_path)
    assert content(tmp_path) == content(undisturbed[0])
    changed = {path for path in paths if path.stat().st_mtime_ns != stamps[path]}
    assert {path.name for path in changed} == {"part-00001.parquet"}
    assert {path.parent.name for path in changed} == {"loop=open"}


KILLED = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from kills import die_at_flush, kills, run_again
from test_montecarlo import LOOPS, fly

root = Path(sys.argv[1])

def make(folder):
    fly(folder, trials=5, loops=LOOPS[::2])  # the two that plan nothing anew: this is about files

def killed(step):
    die_at_flush(step)
    make(root / f"{step:03d}")

make(root / "undisturbed")
for step in kills(killed):
    run_again(lambda: make(root / f"{step:03d}"))
print(step + 1)
"""


@pytest.mark.system
@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks a child for each kill")
def test_killed_at_any_step_of_writing_the_next_run_gives_the_same_bytes(tmp_path, forked):
    """With -9, at each flush of a file or a folder."""
    steps = int(run_script(forked, KILLED, tmp_path, Path(__file__).parent))
    assert steps >= 4 * 2 * 2  # shards and their timings, each flushed before and after its rename
    wanted = content(tmp_path / "undisturbed")
    for step in range(steps):
        folder = tmp_path / f"{step:03d}"
        assert content(folder) == wanted
        assert not list(folder.rglob("*.tmp"))


@pytest.mark.parametrize(
    ("other", "named"),
    [
        (replace(OF, seed=6), "seed = 5, now it is 6"),
        (replace(OF, errors=replace(ERRORS, timing=0.2)), r"errors\.timing = .*, now it is 0\.2"),
        (replace(OF, portion=5), "portion = 4, now it is 5"),
    ],
)
def test_other_settings_do_not_go_into_the_same_folder(undisturbed, other, named):
    before = content(undisturbed[0])
    with pytest.raises(InputError, match=f"begun with {named}"):
        fly(undisturbed[0], of=other)
    assert content(undisturbed[0]) == before


@pytest.mark.parametrize(
    ("planner", "named"),
    [
        (Expert(FIRST_SAFE), r"planner\.settings\.\w+ = "),
        (named_planner("refiner"), r"planner\.class = Expert, now it is FallbackPlanner"),
    ],
    ids=["effort", "network"],
)
def test_another_planner_or_effort_does_not_either(undisturbed, planner, named):
    """Whatever it is called: with no margin both fly the same first plan."""
    before = content(undisturbed[0])
    with pytest.raises(InputError, match=f"begun with {named}"):
        fly(undisturbed[0], loops=[LOOPS[0], replace(LOOPS[1], planner=planner)])
    assert content(undisturbed[0]) == before


def test_networks_are_told_apart_by_their_weights():
    model = load(FOLDER)
    other = deepcopy(model.network)
    next(other.parameters())[0] += 1e-3
    networks = (model, replace(model, network=other), named_planner("refiner").planner.model)
    one, changed, packaged = (identity(NetworkPlanner(network, "refiner")) for network in networks)
    assert one["model"]["digest"] == packaged["model"]["digest"] != changed["model"]["digest"]
    refiner = identity(named_planner("refiner"))
    assert refiner == identity(named_planner("refiner"))
    assert json.loads(json.dumps(refiner)) == refiner


@pytest.mark.untyped  # whose code is no architecture
def test_networks_of_others_are_told_apart_by_their_code(tmp_path, monkeypatch):
    (tmp_path / "their_networks.dist-info").mkdir()
    for name, text in {
        "METADATA": "Name: their-networks\nVersion: 1.2\n",
        "entry_points.txt": "[prolearn.architectures]\nmine = theirs:MINE\n",
    }.items():
        (tmp_path / "their_networks.dist-info" / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    planner = NetworkPlanner(replace(load(FOLDER), architecture="mine"), "mine")

    def told(source):
        (tmp_path / "theirs.py").write_text(source)
        return identity(planner)["model"]

    first, same, changed = map(told, ("MINE = 1", "MINE = 1  # one", "MINE = 2"))
    assert first == same != changed
    assert first["their-networks:theirs"].startswith("1.2+code.")
    ours = identity(NetworkPlanner(load(FOLDER), "refiner"))["model"]
    assert ours.keys() == {"class", "digest"}


def copied(one, other):
    other.write_bytes(one.read_bytes())


def swapped(one, other):
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)


def flipped(one, other):
    damaged = bytearray(other.read_bytes())
    damaged[-60] ^= 1  # in the footer, which no page's checksum is about
    other.write_bytes(damaged)


@pytest.mark.parametrize("damage", [copied, swapped, flipped], ids=lambda f: f.__name__)
@pytest.mark.parametrize("top", ["", "_timings/"])
@pytest.mark.parametrize("forgotten", [False, True], ids=["", "without a manifest"])
def test_shards_in_the_wrong_place_are_flown_again(undisturbed, tmp_path, damage, top, forgotten):
    folder = Path(shutil.copytree(undisturbed[0], tmp_path / "flown"))
    shards = [folder / top / "loop=open" / f"part-0000{k}.parquet" for k in (0, 1)]
    damage(*shards)
    if forgotten:
        for name in ("_manifest.json", "_manifest.copy.json", "_timings/_manifest.json"):
            (folder / name).unlink()
    assert fly(folder)["open"]["trial"].tolist() == list(range(10))
    assert content(folder) == content(undisturbed[0])


def test_a_shard_with_fewer_rows_and_the_same_name_is_not_taken_for_another(undisturbed, tmp_path):
    """As the one of a run that was asked for fewer trials."""
    fly(tmp_path, trials=6)
    (tmp_path / "_manifest.json").unlink()
    assert len(fly(tmp_path, trials=7)["open"]["trial"]) == 7


def test_another_plan_does_not_either(undisturbed):
    with pytest.raises(InputError, match="begun with plan = "):
        fly(undisturbed[0], loops=[Loop("open", 2 * PLAN.controls)])


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda folder: fly(folder, trials=0), "trials is 0; expected a number from 1 to"),
        (lambda folder: replace(OF, seed=-1), "seed is -1; expected a number from 0 to"),
        (lambda folder: fly(folder, jobs=0), "jobs is 0"),
    ],
)
def test_what_cannot_be_flown_is_refused(tmp_path, make, sentence):
    with pytest.raises(InputError, match=sentence):
        make(tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_single_craft_has_no_separation(tmp_path):
    scenario = draw("rings", 0, 1, 0, Problem(nodes=6), "test")
    of, loops = replace(OF, scenario=scenario), [Loop("open", solve(scenario).controls)]
    rows = fly(tmp_path, of=of, loops=loops)["open"]
    assert np.isnan(rows["min_separation"]).all()
    assert np.isfinite(rows["goal_error"]).all()
